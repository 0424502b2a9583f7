"""Attributes of coordinates in datasets, by the CF conventions."""

METRES = {"units": "m"}
DEGREES = {"units": "degrees"}
LON = {"standard_name": "longitude", "units": "degrees_east"}
LAT = {"standard_name": "latitude", "units": "degrees_north"}
TRUE_NORTH = {"long_name": "azimuth, clockwise from true north", **DEGREES}
GRID_NORTH = {"long_name": "azimuth, clockwise from grid north", **DEGREES}
