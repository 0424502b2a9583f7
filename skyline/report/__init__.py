"""What a person sees: pictures, maps, pages that need no network, and GeoJSON.

Names are loaded when they are first used (`__init__.pyi` says from where): what draws takes half
a second to load.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
