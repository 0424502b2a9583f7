"""Results to look at and to pass on: pages, pictures, maps and files."""
