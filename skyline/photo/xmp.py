"""The XMP of a photo: what its file notes beside EXIF.

XMP is RDF, written as XML (ISO 16684-1). A property is named by its namespace and a local name. It
may have any prefix, and be an attribute or an element of any description. So XMP is parsed, never
searched as text. Declarations of entities are refused, since they can expand without bound.
"""

import io
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from json import detect_encoding
from xml.etree.ElementTree import C14NWriterTarget, Element, ParseError

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import DefusedXMLParser, fromstring
from PIL import Image

IN_JPEG = b"http://ns.adobe.com/xap/1.0/\x00"
"""The beginning of a JPEG segment that holds a packet of XMP."""
EXTENDED = b"http://ns.adobe.com/xmp/extension/\x00"
"""The beginning of a JPEG segment that holds a part of a second packet, which is longer than a
segment."""
HAS_EXTENDED = ("http://ns.adobe.com/xmp/note", "HasExtendedXMP")
"""The property of the first packet that refers to the second."""
XMP_TAG = 700
"""The tag of XMP in a TIFF, and in EXIF."""
_RDF = "{http://www.w3.org/1999/02/22-rdf-syntax-ns#}"
_IN_PNG = ("Raw profile type xmp", "Raw profile type APP1")
"""Keys of the text in which ImageMagick keeps XMP in a PNG, in hexadecimal digits."""
_DIGEST_BYTES = 32
"""Length of the packet's digest, with which a part of an extended packet begins."""
_LENGTH_BYTES = 4
"""Length of the packet's length, which follows the digest."""
_OFFSET_BYTES = 4
"""Length of the part's offset in the packet, which follows the packet's length."""
_LARGEST = 1 << 25
"""Most bytes of a packet that is parsed. The largest in use hold a depth map of some megabytes."""
_NOT_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")
"""Characters that XML forbids, and damaged packets contain."""

Name = tuple[str, str]
"""A property's namespace, without a slash or hash at its end, and its local name."""


class BrokenXmpError(Exception):
    """A packet cannot be parsed, is too large, or declares entities."""


@dataclass(frozen=True, slots=True)
class Xmp:
    """The properties of a photo's XMP that have one value.

    Attributes
    ----------
    values : dict of (str, str) to str
        The values by `Name`, without spaces around them.
    broken : str
        The text of packets that cannot be parsed.
    """

    values: dict[Name, str] = field(default_factory=dict)
    broken: str = ""

    def of(self, namespace: str) -> dict[str, str]:
        """Return the values of a namespace by their local names."""
        return {name: value for (space, name), value in self.values.items() if space == namespace}

    def first(self, *names: str) -> str | None:
        """Return the first value of some local names, in any namespace."""
        return next((value for (_, name), value in self.values.items() if name in names), None)


NO_XMP = Xmp()


def xmp_of(image: Image.Image) -> Xmp:
    """Return the properties in all packets of an opened image.

    Where two packets note a property, the first counts. A PNG may keep XMP after its pixels: load
    it first.
    """
    values: dict[Name, str] = {}
    broken = ""
    for packet in dict.fromkeys(_packets(image)):
        try:
            values = _properties(_parsed(packet)) | values
        except BrokenXmpError:
            broken += _decoded(packet[:_LARGEST])
    return Xmp(values, broken)


def without(packet: bytes, is_unwanted: Callable[[Name], bool]) -> bytes:
    """Return a packet without the attributes and elements of unwanted names.

    A packet without any is returned as it is. Raises `BrokenXmpError`.
    """
    unwanted = {name for name in _names(_parsed(packet)) if is_unwanted(_split(name))}
    if not unwanted:
        return packet
    kept = io.StringIO()
    # The canonical form keeps prefixes, which ElementTree's own writer replaces.
    writer = C14NWriterTarget(
        kept.write, with_comments=True, exclude_attrs=unwanted, exclude_tags=unwanted
    )
    parser = DefusedXMLParser(target=writer)
    parser.feed(_xml_of(packet))
    parser.close()
    return kept.getvalue().encode()


def joined(parts: Sequence[bytes]) -> list[bytes]:
    """Return the packets in a JPEG's segments that begin with `EXTENDED`."""
    packets = defaultdict[bytes, list[tuple[int, bytes]]](list)
    for part in parts:
        held = part[len(EXTENDED) :]
        digest = held[:_DIGEST_BYTES]
        rest = held[_DIGEST_BYTES + _LENGTH_BYTES :]
        offset = int.from_bytes(rest[:_OFFSET_BYTES], "big")
        packets[digest].append((offset, rest[_OFFSET_BYTES:]))
    return [b"".join(data for _, data in sorted(found)) for found in packets.values()]


def _packets(image: Image.Image) -> Iterator[bytes]:
    """Yield the packets of XMP in an image of any format."""
    segments = [body for marker, body in getattr(image, "applist", []) if marker == "APP1"]
    for body in segments:
        if body.startswith(IN_JPEG):
            yield body.removeprefix(IN_JPEG)
    if not segments:
        for key in ("xmp", "XML:com.adobe.xmp"):
            if found := image.info.get(key):
                yield found if isinstance(found, bytes) else str(found).encode()
    in_exif = image.getexif().get(XMP_TAG)
    if isinstance(in_exif, bytes):
        yield in_exif
    for key in _IN_PNG:
        with suppress(ValueError):
            # A line for the kind, one for the length, and lines of digits.
            digits = str(image.info.get(key, "")).split()[2:]
            profile = bytes.fromhex("".join(digits))
            if key == _IN_PNG[0] or profile.startswith(IN_JPEG):
                yield profile.removeprefix(IN_JPEG)
    yield from joined([body for body in segments if body.startswith(EXTENDED)])


def _parsed(packet: bytes) -> Element:
    if len(packet) > _LARGEST:
        raise BrokenXmpError(f"it has {len(packet)} bytes; expected at most {_LARGEST}")
    try:
        root: Element = fromstring(_xml_of(packet))
    except (ParseError, DefusedXmlException) as error:
        raise BrokenXmpError(str(error)) from error
    return root


def _xml_of(packet: bytes) -> str:
    """Return a packet's XML, without the spaces and zeros around it."""
    text = _decoded(packet)
    begin = text.find("<")
    end = text.rfind(">") + 1
    return _NOT_XML.sub("", text[begin:end]) if 0 <= begin < end else ""


def _decoded(packet: bytes) -> str:
    """Return the text of a packet in any encoding of Unicode."""
    # JSON begins with ASCII as XML does, and its encoding is found in the same way.
    return packet.decode(detect_encoding(packet), errors="replace")


def _properties(root: Element) -> dict[Name, str]:
    """Return the properties in a packet; the first of a name counts."""
    found: dict[Name, str] = {}
    for rdf in root.iter(f"{_RDF}RDF"):
        for description in rdf:
            noted = [*description.items(), *((one.tag, _value(one)) for one in description)]
            for name, value in noted:
                found.setdefault(_split(name), value.strip())
    return found


def _value(element: Element) -> str:
    """Return the first text in a property's element.

    It may be in ``rdf:value`` or in a list. It is empty for a structure without text.
    """
    whole = element.get(f"{_RDF}value", "").strip()
    texts = ((one.text or "").strip() for one in element.iter())
    return whole or next(filter(None, texts), "")


def _names(root: Element) -> Iterator[str]:
    """Yield the names of all elements and attributes, as ElementTree writes them."""
    for element in root.iter():
        yield element.tag
        yield from element.keys()


def _split(name: str) -> Name:
    """Return the namespace and local name of an ElementTree name."""
    namespace, _, local = name.rpartition("}")
    return namespace.removeprefix("{").rstrip("/#"), local
