"""The local web page: open photos, correct their skylines, and find and fit their places."""
