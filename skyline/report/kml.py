"""KML 2.2 (OGC 07-147r2): documents, shapes and their XML."""

from collections.abc import Iterable, Sequence
from xml.etree import ElementTree as Xml

from skyline.errors import printable

Coordinates = Iterable[Sequence[float]]
"""Longitudes and latitudes, and perhaps elevations."""


def kml_document() -> tuple[Xml.Element, Xml.Element]:
    """Return a new KML file's root and the document in it."""
    root = Xml.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    return root, add(root, "Document")


def add(parent: Xml.Element, tag: str, text: str = "", **attributes: str) -> Xml.Element:
    """Add an element with a text, and return it."""
    element = Xml.SubElement(parent, tag, attributes)
    if text:
        element.text = printable(text)
    return element


def add_polygon(parent: Xml.Element, rings: Iterable[Coordinates]) -> None:
    """Add a polygon: its outline, then its holes, all closed."""
    polygon = add(parent, "Polygon")
    for number, ring in enumerate(rings):
        side = add(polygon, "innerBoundaryIs" if number else "outerBoundaryIs")
        add_coordinates(add(side, "LinearRing"), ring)


def add_coordinates(parent: Xml.Element, places: Coordinates) -> None:
    """Add the coordinates of a shape."""
    add(parent, "coordinates", " ".join(",".join(map(str, place)) for place in places))


def xml_bytes(root: Xml.Element) -> bytes:
    """Return the content of an XML file."""
    return bytes(Xml.tostring(root, encoding="utf-8", xml_declaration=True))
