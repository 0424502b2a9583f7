"""Pictures, maps, pages that need no network, and files for other programs."""
