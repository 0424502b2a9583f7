"""The local web page: photos, their skylines and their places."""
