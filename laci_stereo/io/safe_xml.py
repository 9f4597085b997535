"""XML from strangers: no document type, hence no entities that grow without end or read other files."""

from __future__ import annotations

from xml.etree import ElementTree


class XmlError(ValueError):
    """The text is not XML that can be read safely."""


def parse_xml(text: str) -> ElementTree.Element:
    """Return the root element.

    Raises
    ------
    XmlError
        If the text is not well-formed, or declares a document type.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise XmlError("a document type (<!DOCTYPE or <!ENTITY) is refused; needed is plain XML")
    try:
        return ElementTree.fromstring(text)  # noqa: S314 - what makes it unsafe is refused above
    except (ElementTree.ParseError, ValueError) as problem:
        raise XmlError(f"{problem}; needed is well-formed XML") from problem
