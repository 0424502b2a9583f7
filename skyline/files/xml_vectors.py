"""The shapes of SVG and GPX."""

import re
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from skyline.arrays import Float64Array
from skyline.errors import InputError, printable
from skyline.files.disk import read_bytes
from skyline.files.shapes import (
    CORNER_PX,
    EXPECTED,
    LINE,
    POINT,
    POLYGON,
    Shape,
    Vectors,
    box_ring,
    ring_of,
)

_SVG_SHAPES = ("polygon", "polyline", "line", "rect", "circle", "ellipse", "path")
_SVG_UNSEEN = ("defs", "clipPath", "mask", "symbol", "marker", "pattern")
"""Elements of SVG whose shapes are not drawn where they stand."""
_SVG_HIDES = re.compile(r"\b(display\s*:\s*none|visibility\s*:\s*(hidden|collapse))")
_SVG_RULE = re.compile(r"([^{}]*)\{([^{}]*)\}")
_SVG_NAME = re.compile(r"(?:[\w-]*[.#])?[\w-]+")
"""A selector of one element's class, id or name, the only ones that programs write."""
_SVG_MOVES = re.compile(r"\b(transform|translate|rotate|scale)\s*:\s*(?!none)\S")
_SVG_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_SVG_STEP = re.compile(rf"([a-zA-Z])|({_SVG_NUMBER})")


def _root_of(path: Path) -> Element:
    """Return the root of an XML file."""
    try:
        root: Element = fromstring(read_bytes(path, EXPECTED))
    except (ParseError, DefusedXmlException, ValueError) as error:
        raise InputError(f"{path} cannot be read as XML ({error}); {EXPECTED}") from None
    return root


def _tag(one: Element) -> str:
    """Return an element's name without its namespace."""
    return one.tag.rpartition("}")[2] if isinstance(one.tag, str) else ""


def read_gpx(path: Path) -> Vectors:
    """Return the waypoints, routes and segments of tracks of GPX."""
    return Vectors(path, tuple(_gpx_shapes(path, _root_of(path))), in_pixels=False)


def _gpx_shapes(path: Path, root: Element) -> Iterator[Shape]:
    def named(one: Element) -> dict[str, str]:
        names = [child.text or "" for child in one if _tag(child) == "name"]
        return {"name": names[0]} if names else {}

    def ring(points: Sequence[Element]) -> tuple[Float64Array, ...]:
        places = [(float(one.get("lon", "")), float(one.get("lat", ""))) for one in points]
        return (ring_of(places),)

    try:
        for number, one in enumerate(root, start=1):
            where = f"element {number}"
            if _tag(one) == "wpt":
                yield Shape(POINT, ring([one]), where, named(one))
            elif _tag(one) == "rte":
                points = [point for point in one if _tag(point) == "rtept"]
                yield Shape(LINE, ring(points), where, named(one))
            elif _tag(one) == "trk":
                for part in (part for part in one if _tag(part) == "trkseg"):
                    points = [point for point in part if _tag(point) == "trkpt"]
                    if len(points) > 1:
                        yield Shape(LINE, ring(points), where, named(one))
    except ValueError:
        raise InputError(
            f"{path}, element {number} has a place without lon and lat; {EXPECTED}"
        ) from None


def read_svg(path: Path) -> Vectors:
    """Return the polygons, lines and points of simple SVG; circles are points."""
    root = _root_of(path)
    box = [float(one) for one in re.findall(_SVG_NUMBER, root.get("viewBox", ""))]
    sides = [re.match(_SVG_NUMBER, root.get(side, "")) for side in ("width", "height")]
    size = box[2:] if len(box) == 4 else [float(one[0]) for one in sides if one is not None]
    corner = box[:2] if len(box) == 4 else [0.0, 0.0]
    hiding = set(_hiding_selectors(path, root))
    hidden = [one for one in root.iter() if _tag(one) in _SVG_UNSEEN or _is_hidden(one, hiding)]
    unseen = {part for one in hidden for part in one.iter()}
    shapes = []
    for number, one in enumerate(root.iter(), start=1):
        where = f"element {number} ({_tag(one)})"
        if one in unseen and _tag(one) != "style":
            continue
        is_moved = one.get("transform") or _SVG_MOVES.search(_style_of(one))
        if is_moved or (_tag(one) in ("svg", "use") and one is not root):
            raise InputError(
                f"{path}, {where} moves shapes; expected shapes in the photo's pixels: apply the "
                "transforms and unlink clones, or export GeoJSON"
            )
        if _tag(one) in _SVG_SHAPES:
            about = {"id": one.get("id")} if one.get("id") else {}
            shapes += [
                Shape(kind, (ring - corner - CORNER_PX,), where, about)
                for kind, ring in _svg_rings(path, where, one)
            ]
    if not np.isfinite([*size, *corner]).all():
        raise InputError(f"{path} has a viewBox that is not finite; expected the photo's pixels")
    size_px = (round(size[0]), round(size[1])) if len(size) == 2 else None
    return Vectors(path, tuple(shapes), in_pixels=True, size_px=size_px)


def _style_of(one: Element) -> str:
    """Return an element's style, or the rules of the element ``style``."""
    return (one.text or "") if _tag(one) == "style" else one.get("style", "")


def _hiding_selectors(path: Path, root: Element) -> Iterator[str]:
    """Yield the selectors of an SVG's rules that hide elements.

    They are as ``.st0``, ``#sketch`` or ``g``; Illustrator hides layers so. Raises `InputError` for
    other selectors.
    """
    sheets = [one.text or "" for one in root.iter() if _tag(one) == "style"]
    for selectors, rules in _SVG_RULE.findall(
        re.sub(r"/\*.*?\*/", "", " ".join(sheets), flags=re.S)
    ):
        if not _SVG_HIDES.search(rules):
            continue
        for one in map(str.strip, selectors.split(",")):
            if not _SVG_NAME.fullmatch(one):
                raise InputError(
                    f"{path} hides shapes by the rule {printable(one)[:40]}; expected one class or "
                    "id: delete what is hidden, or export GeoJSON"
                )
            yield one


def _is_hidden(one: Element, hiding: Collection[str]) -> bool:
    """Return whether an element is hidden, as a layer may be.

    ``hiding`` has the selectors of rules that hide elements.
    """
    own = f"display:{one.get('display')};visibility:{one.get('visibility')};{one.get('style')}"
    tag = _tag(one)
    marks = [f".{name}" for name in one.get("class", "").split()] + [f"#{one.get('id')}"]
    names = {tag, *marks, *(f"{tag}{mark}" for mark in marks)}
    return bool(_SVG_HIDES.search(own)) or not names.isdisjoint(hiding)


def _svg_rings(path: Path, where: str, one: Element) -> Iterator[tuple[str, Float64Array]]:
    """Yield the kind and the vertices of an SVG shape's parts."""

    def numbers(*names: str) -> list[float]:
        texts = [one.get(name, "0") for name in names]
        for text in texts:
            if not re.fullmatch(rf"{_SVG_NUMBER}(px)?", text):
                raise InputError(
                    f"{path}, {where} has the coordinate {printable(text)[:40]}; expected pixels: "
                    "export it without other units, or GeoJSON"
                )
        return [float(text.removesuffix("px")) for text in texts]

    tag = _tag(one)
    if tag in ("polygon", "polyline"):
        given = [float(number) for number in re.findall(_SVG_NUMBER, one.get("points", ""))]
        if len(given) % 2:
            raise InputError(f"{path}, {where} has {len(given)} numbers; expected columns and rows")
        yield POLYGON if tag == "polygon" else LINE, np.reshape(given, (-1, 2))
    elif tag == "line":
        yield LINE, np.reshape(numbers("x1", "y1", "x2", "y2"), (2, 2))
    elif tag == "rect":
        left, top, width, height = numbers("x", "y", "width", "height")
        yield POLYGON, box_ring(left, top, left + width, top + height)
    elif tag in ("circle", "ellipse"):
        yield POINT, np.array([numbers("cx", "cy")])
    else:
        yield from _svg_path(path, one.get("d", ""))


def _svg_path(path: Path, steps: str) -> Iterator[tuple[str, Float64Array]]:
    """Yield the straight parts of an SVG path."""
    at = start = 0j
    ring: list[complex] = []
    letter = "M"
    given: list[float] = []

    def vertices() -> Float64Array:
        return np.array([(one.real, one.imag) for one in ring])

    for name, number in _SVG_STEP.findall(steps):
        if name:
            letter, given = name, []
            if name in "Zz":
                yield POLYGON, vertices()
                ring, at = [], start
            continue
        given.append(float(number))
        base = at if letter.islower() else 0j
        if letter in "Hh":
            at = complex(base.real + given.pop(), at.imag)
        elif letter in "Vv":
            at = complex(at.real, base.imag + given.pop())
        elif letter not in "MmLl":
            raise InputError(
                f"{path} has a path with the step {letter}; expected straight lines (M, L, H, V, "
                "Z): flatten the curves, or export GeoJSON"
            )
        elif len(given) < 2:
            continue
        else:
            at = base + complex(*given)
            if letter in "Mm":
                if len(ring) > 1:
                    yield LINE, vertices()
                ring, start, letter = [], at, "l" if letter == "m" else "L"
            given = []
        if not ring and at != start:
            ring.append(start)
        ring.append(at)
    if len(ring) > 1:
        yield LINE, vertices()
