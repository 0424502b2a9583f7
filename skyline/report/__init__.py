"""Reports of results: pages, pictures, maps and files."""
