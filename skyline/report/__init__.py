"""Results to look at and to pass on: pictures, maps, HTML pages, and files for other programs."""
