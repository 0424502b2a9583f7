"""Files in others' formats, and how files are read and written whole."""
