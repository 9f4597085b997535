"""Width, height and bit depth that an image file's header states, read before anything is decoded."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator

Size = tuple[int, int]
"""Width and height, pixels."""

JPEG_END = 0xD9
_JPEG_MARKER = re.compile(rb"\xff[\xc0-\xcf\xd8-\xfe]")
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
PNM_HEADER = re.compile(
    rb"P([1-6])(?:\s|#[^\n]*\n)+(\d{1,6})(?:\s|#[^\n]*\n)+(\d{1,6})(?:(?:\s|#[^\n]*\n)+(\d{1,6}))?\s"
)
_TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_BITS = 256, 257, 258
_TIFF_WHOLE_NUMBERS = {1: "B", 3: "H", 4: "I", 6: "b", 8: "h", 9: "i", 16: "Q", 17: "q"}
"""Integer types of TIFF entries, and their struct format characters."""
_MOST_SAMPLES = 16
"""Most samples per pixel whose bits are checked; colours and alpha are at most five."""
_TIFF = rb"II[*+]\0|MM\0[*+]"


def stated_size(content: bytes) -> Size | None:
    """Return the width and height that an image file states: PNG, JPEG, TIFF, BMP, WebP or a portable anymap.

    None if the first bytes are of none of these formats, or the header is cut off.
    """
    read = next((read for start, read in _HEADERS if re.match(start, content, re.DOTALL)), None)
    try:
        return None if read is None else read(content)
    except (struct.error, OverflowError):  # an offset in the header is beyond the end of the file
        return None


def stated_bits(content: bytes) -> int:
    """Return the bits per sample that a TIFF states, 0 if none; 0 for other formats, which have at most 16."""
    try:
        return _tiff_entries(content).get(_TIFF_BITS, 0) if re.match(_TIFF, content) else 0
    except (struct.error, OverflowError):
        return 0


def jpeg_segments(content: bytes) -> Iterator[tuple[int, int]]:
    """Yield the marker of each segment and the position of its length, up to the end marker."""
    at = 2
    while (match := _JPEG_MARKER.search(content, at)) is not None:
        marker = content[match.start() + 1]
        yield marker, match.end()
        if marker == JPEG_END or match.end() + 2 > len(content):
            return
        (length,) = struct.unpack_from(">H", content, match.end())
        at = match.end() + length


def _png(content: bytes) -> Size | None:
    width, height = struct.unpack_from(">II", content, 16)
    return (width, height) if content[12:16] == b"IHDR" else None


def _jpeg(content: bytes) -> Size | None:
    frame = next((at for marker, at in jpeg_segments(content) if marker in _JPEG_FRAMES), None)
    if frame is None:
        return None
    height, width = struct.unpack_from(">HH", content, frame + 3)
    return width, height


def _tiff(content: bytes) -> Size | None:
    told = _tiff_entries(content)
    return (told[_TIFF_WIDTH], told[_TIFF_HEIGHT]) if {_TIFF_WIDTH, _TIFF_HEIGHT} <= told.keys() else None


def _tiff_entries(content: bytes) -> dict[int, int]:
    """Return a TIFF's width, height and bits per sample by tag, as far as stated; of several values the greatest."""
    order = "<" if content.startswith(b"I") else ">"
    big = content[2:4] in (b"+\0", b"\0+")
    offset, count, entry = ("Q", "Q", 20) if big else ("I", "H", 12)
    (at,) = struct.unpack_from(order + offset, content, 8 if big else 4)
    (entries,) = struct.unpack_from(order + count, content, at)
    at += struct.calcsize(order + count)
    found: dict[int, int] = {}
    for _ in range(min(entries, (len(content) - at) // entry)):
        tag, kind, values = struct.unpack_from(order + "HH" + offset, content, at)
        if tag in (_TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_BITS) and kind in _TIFF_WHOLE_NUMBERS:
            form = f"{order}{min(max(values, 1), _MOST_SAMPLES)}{_TIFF_WHOLE_NUMBERS[kind]}"
            place = at + (12 if big else 8)
            if struct.calcsize(form) > struct.calcsize(order + offset):  # the entry holds an offset instead
                (place,) = struct.unpack_from(order + offset, content, place)
            found[tag] = max(*struct.unpack_from(form, content, place), found.get(tag, 0))
        at += entry
    return found


def _bmp(content: bytes) -> Size | None:
    (header,) = struct.unpack_from("<I", content, 14)
    width, height = struct.unpack_from("<HH" if header == 12 else "<ii", content, 18)
    return abs(width), abs(height)


def _webp(content: bytes) -> Size | None:
    kind = content[12:16]
    if kind == b"VP8X":
        return int.from_bytes(content[24:27], "little") + 1, int.from_bytes(content[27:30], "little") + 1
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", content, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    width, height = struct.unpack_from("<HH", content, 26)
    return width & 0x3FFF, height & 0x3FFF


def _pnm(content: bytes) -> Size | None:
    match = PNM_HEADER.match(content)
    return None if match is None else (int(match[2]), int(match[3]))


_HEADERS: tuple[tuple[bytes, Callable[[bytes], Size | None]], ...] = (
    (rb"\x89PNG\r\n\x1a\n", _png),
    (rb"\xff\xd8\xff", _jpeg),
    (_TIFF, _tiff),
    (rb"BM", _bmp),
    (rb"RIFF....WEBP", _webp),
    (rb"P[1-6]", _pnm),
)
