"""The local page: photos in, their skylines mended, places found and fitted by hand."""
