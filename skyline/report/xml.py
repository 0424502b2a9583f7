"""Elements of XML documents, whatever text a user's file names bring."""

import re
from xml.etree import ElementTree as Xml

_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""What XML 1.0 has no way to say."""


def document(tag: str, namespace: str, **attributes: str) -> Xml.Element:
    """Return the root of a document, all of whose elements are of one namespace."""
    return Xml.Element(tag, {"xmlns": namespace, **attributes})


def child(parent: Xml.Element, tag: str, text: str = "", **attributes: str) -> Xml.Element:
    """Return a new last child of an element."""
    element = Xml.SubElement(parent, tag, attributes)
    if text:
        element.text = _NOT_XML.sub("\ufffd", text)
    return element
