"""OpenCV's FileStorage files, read without OpenCV, whose own reader hangs or crashes on many malformed ones."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import TypeAlias
from xml.etree.ElementTree import Element

from laci_stereo.io.safe_xml import XmlError, parse_xml

Node: TypeAlias = "float | str | list[Node] | dict[str, Node]"
"""A node of such a file: a number, a text, a sequence, or a mapping of names to nodes."""

_DEEPEST = 20
# None of these patterns backtracks over the same characters, so the time is linear in the text's length.
_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)(e[+-]?[0-9]+)?|[+-]?\.?(nan|inf)", re.IGNORECASE)
_TAG = re.compile(r"!\S*\s*|&\S+\s*")
_KEY = re.compile(r"""("[^"]*"\s*|'[^']*'\s*|[^\s"'\[\]{},#][^"'\[\]{}:]*):(?:\s+(.*))?""", re.DOTALL)
_QUOTED = r""""(?:[^"\\]|\\.)*(?:"|\\?\Z)|'[^']*'"""
_COMMENT = re.compile(rf"({_QUOTED})|(?:^|(?<=\s))#.*")
_FLOW_WORD = re.compile(rf"""{_QUOTED}|[\[\]{{}},]|[^\s\[\]{{}},"'][^\[\]{{}},"']*""")


class StorageError(ValueError):
    """The text is not what OpenCV's FileStorage writes."""


def parse_file_storage(text: str) -> Mapping[str, Node]:
    """Parse YAML, JSON or XML as OpenCV writes them; the first character determines the syntax.

    Supported is the part of YAML that such files use: block and flow mappings and sequences of plain scalars, in one
    document.

    Raises
    ------
    StorageError
        If the text is none of these, or nests deeper than such files do.
    """
    start = text.lstrip()[:1]
    if start == "{":
        root = _parse_json(text)
    elif start == "<":
        root = _parse_xml(text)
    else:
        root = _YamlReader(text).read()
    if not isinstance(root, dict):
        raise StorageError("it holds no names; needed are entries such as 'K1: ...'")
    return root


def _parse_json(text: str) -> Node:
    try:
        return _from_json(json.loads(text, parse_int=float), 0)
    except (ValueError, RecursionError) as problem:
        raise StorageError(f"{problem}; needed is well-formed JSON") from problem


def _from_json(value: object, depth: int) -> Node:
    _check_depth(depth)
    if isinstance(value, dict):
        return {str(key): _from_json(inner, depth + 1) for key, inner in value.items()}
    if isinstance(value, list):
        return [_from_json(inner, depth + 1) for inner in value]
    return value if isinstance(value, float) else str(value)


def _parse_xml(text: str) -> Node:
    try:
        return _from_xml(parse_xml(text), 0)
    except XmlError as problem:
        raise StorageError(str(problem)) from problem


def _from_xml(element: Element, depth: int) -> Node:
    _check_depth(depth)
    if len(element) and all(child.tag == "_" for child in element):
        return [_from_xml(child, depth + 1) for child in element]
    if len(element):
        return {child.tag: _from_xml(child, depth + 1) for child in element}
    words = (element.text or "").split()
    if not words or not all(_NUMBER.fullmatch(word) for word in words):
        return (element.text or "").strip().strip('"')
    numbers: list[Node] = [_scalar(word) for word in words]
    return numbers[0] if len(numbers) == 1 else numbers


def _check_depth(depth: int) -> None:
    if depth > _DEEPEST:
        raise StorageError(f"it nests deeper than {_DEEPEST} levels")


def _scalar(word: str) -> Node:
    if word[:1] in "\"'" and word[:1] == word[-1:]:
        return word[1:-1]
    return float(word.lower().replace(".nan", "nan").replace(".inf", "inf")) if _NUMBER.fullmatch(word) else word


class _YamlReader:
    """A reader of the lines of a YAML document and their indents, from first to last."""

    def __init__(self, text: str) -> None:
        self._lines = list(_logical_lines(text))
        self._at = 0

    def read(self) -> Node:
        root = self._block(0)
        if self._at < len(self._lines):
            raise StorageError(f"line {self._lines[self._at][0]}: the indent fits to no line above")
        return root

    def _block(self, depth: int) -> Node:
        _check_depth(depth)
        if self._at >= len(self._lines):
            return ""
        _, indent, content = self._lines[self._at]
        if content == "-" or content.startswith("- "):
            return self._sequence(indent, depth)
        if _KEY.fullmatch(content):
            return self._map(indent, depth)
        self._at += 1
        return _flow(content, self._lines[self._at - 1][0])

    def _sequence(self, indent: int, depth: int) -> list[Node]:
        items: list[Node] = []
        while self._at < len(self._lines):
            line, found, content = self._lines[self._at]
            if found != indent or not (content == "-" or content.startswith("- ")):
                break
            inner = content[1:].lstrip()
            if inner:
                # The text after the dash is a block of its own, as if it were on a line of its own.
                self._lines[self._at] = (line, indent + len(content) - len(inner), inner)
                items.append(self._block(depth + 1))
            else:
                self._at += 1
                items.append(self._inner(indent + 1, depth))
        return items

    def _map(self, indent: int, depth: int) -> dict[str, Node]:
        entries: dict[str, Node] = {}
        while self._at < len(self._lines):
            line, found, content = self._lines[self._at]
            match = _KEY.fullmatch(content)
            if found != indent or match is None:
                break
            self._at += 1
            value = _TAG.sub("", match[2] or "", count=1) if (match[2] or "")[:1] in "!&" else match[2]
            key = match[1].strip().strip("\"'")
            entries[key] = _flow(value, line) if value else self._value_below(indent, depth)
        return entries

    def _value_below(self, indent: int, depth: int) -> Node:
        # In YAML, a sequence in a mapping may have the same indent as its key.
        dash = self._at < len(self._lines) and self._lines[self._at][2].startswith("-")
        return self._inner(indent if dash else indent + 1, depth)

    def _inner(self, least_indent: int, depth: int) -> Node:
        if self._at < len(self._lines) and self._lines[self._at][1] >= least_indent:
            return self._block(depth + 1)
        return ""


def _logical_lines(text: str) -> Iterator[tuple[int, int, str]]:
    """Yield number, indent and content of each line; a flow collection over several lines counts as one line."""
    pending: list[str] = []
    start, depth = 0, 0
    for i, raw in enumerate(text.splitlines(), start=1):
        line = _COMMENT.sub(lambda match: match[1] or "", raw).rstrip()
        if not line.strip() or line.startswith(("%", "---", "...")):
            continue
        if depth:
            pending.append(line.strip())
        else:
            pending, start = [line], i
        bare = re.sub(_QUOTED, "", line)
        depth += bare.count("[") + bare.count("{") - bare.count("]") - bare.count("}")
        if depth <= 0:
            content = pending[0].lstrip()
            yield start, len(pending[0]) - len(content), " ".join([content, *pending[1:]])
            depth = 0
    if depth:
        raise StorageError(f"line {start}: a bracket is never closed")


def _flow(text: str, line: int) -> Node:
    """Parse a scalar, or a sequence or mapping in brackets."""
    if text[:1] not in ("[", "{"):
        return _scalar(text)
    words = _FLOW_WORD.findall(text)
    root, end = _flow_node(words, 0, 0, line)
    if end < len(words):
        raise StorageError(f"line {line}: the brackets do not match")
    return root


def _flow_node(words: list[str], at: int, depth: int, line: int) -> tuple[Node, int]:
    """Return the node that begins at a word, and the index of the word after the node."""
    _check_depth(depth)
    if words[at] not in ("[", "{"):
        return _scalar(words[at].strip()), at + 1
    closing = "]" if words[at] == "[" else "}"
    items: list[Node] = []
    entries: dict[str, Node] = {}
    at += 1
    while at < len(words) and words[at] not in ("]", "}"):
        if words[at] == ",":
            at += 1
        elif closing == "]":
            item, at = _flow_node(words, at, depth + 1, line)
            items.append(item)
        else:
            # "name: value" is one word, and so is "name: " before a bracket.
            name, _, value = words[at].partition(":")
            inner = not value.strip() and at + 1 < len(words) and words[at + 1] in ("[", "{")
            node, at = _flow_node(words, at + 1, depth + 1, line) if inner else (_scalar(value.strip()), at + 1)
            entries[name.strip("\"' ")] = node
    if at >= len(words) or words[at] != closing:
        raise StorageError(f"line {line}: the brackets do not match")
    return (items if closing == "]" else entries), at + 1
