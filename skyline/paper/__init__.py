"""The methods of the paper: matcher (3), reprojection error (4.2), strategies (4.3)."""
