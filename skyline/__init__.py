"""A photo of mountains in, a place on the map out.

>>> from skyline import Matcher, build_places, read_dem
>>> build_places(read_dem(["dem.tif"]), "store.h5")
>>> answer = Matcher("store.h5").match("photo.jpg", fov_deg=60.0).answer
>>> answer.lon, answer.lat, answer.heading_deg  # degrees, from true north

Names are loaded when they are first used (`__init__.pyi` says from where), so that
``import skyline`` is quick and needs no OpenGL.
"""

from importlib.metadata import version

import lazy_loader

__version__ = version("skyline")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
