"""XML from untrusted sources: without document types, and so without entities that expand endlessly or read files."""

from __future__ import annotations

from xml.etree import ElementTree


class XmlError(ValueError):
    """The text is no XML, or not safe to parse."""


def parse_xml(text: str) -> ElementTree.Element:
    """Return the root element.

    Raises
    ------
    XmlError
        If the text is not well-formed or declares a document type.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise XmlError("a document type (<!DOCTYPE or <!ENTITY) is refused; needed is plain XML")
    try:
        return ElementTree.fromstring(text)  # noqa: S314 - what makes it unsafe is refused above
    except (ElementTree.ParseError, ValueError) as problem:
        raise XmlError(f"{problem}; needed is well-formed XML") from problem
