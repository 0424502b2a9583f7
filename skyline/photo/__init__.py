"""From photos, sky masks and traces to skylines in pixels, and what their files note."""
