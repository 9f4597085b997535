"""Damage that image decoders tolerate: a truncated image decodes to grey areas with no more than a warning."""

from __future__ import annotations

import struct
import zlib

from laci_stereo.io.image_size import JPEG_END, PNM_HEADER, jpeg_segments, stated_size

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_JPEG_PIXELS_PER_BYTE = 512
"""A block of 8 x 8 pixels takes at least one bit, the shortest Huffman code; a header that states more pixels is
wrong."""
_CUT_OFF = "is cut off"


def damage(content: bytes) -> str | None:
    """Return what is wrong with an image file's content; None if it looks intact, which only decoding can confirm."""
    if not content:
        return "is empty"
    if content.startswith(_PNG):
        return _png_damage(content)
    if content.startswith(_JPEG):
        return _jpeg_damage(content)
    if content.startswith(b"BM"):
        return _bmp_damage(content)
    if content.startswith((b"P4", b"P5", b"P6")):
        return _pnm_damage(content)
    return None


def _png_damage(content: bytes) -> str | None:
    at = len(_PNG)
    while at + 12 <= len(content):
        (length,) = struct.unpack_from(">I", content, at)
        body = content[at + 4 : at + 8 + length]
        checksum = content[at + 8 + length : at + 12 + length]
        if len(checksum) < 4:
            break
        if zlib.crc32(body).to_bytes(4, "big") != checksum:
            return f"is damaged (checksum of the PNG chunk at byte {at})"
        if body[:4] == b"IEND":
            return None
        at += 12 + length
    return f"{_CUT_OFF} after {len(content)} bytes (a PNG without its end)"


def _jpeg_damage(content: bytes) -> str | None:
    # A thumbnail in the EXIF data has its own end marker, so a search for the marker is not enough.
    width, height = stated_size(content) or (0, 0)
    if width * height > _JPEG_PIXELS_PER_BYTE * len(content):
        return f"promises {width} x {height} pixels in {len(content)} bytes (a JPEG)"
    if all(marker != JPEG_END for marker, _ in jpeg_segments(content)):
        return f"{_CUT_OFF} after {len(content)} bytes (a JPEG without its end)"
    return None


def _bmp_damage(content: bytes) -> str | None:
    if len(content) < 54:
        return f"{_CUT_OFF} after {len(content)} bytes (a BMP)"
    (offset,) = struct.unpack_from("<I", content, 10)
    (header,) = struct.unpack_from("<I", content, 14)
    if header < 40:
        return None
    width, height, _, depth, compression = struct.unpack_from("<iiHHI", content, 18)
    if compression not in (0, 3):
        return None
    needed = offset + (abs(width) * depth + 31) // 32 * 4 * abs(height)
    return _short(content, needed, "BMP")


def _pnm_damage(content: bytes) -> str | None:
    match = PNM_HEADER.match(content)
    if match is None:
        return None
    kind, width, height = (int(match[i]) for i in (1, 2, 3))
    if kind == 4:
        # A PBM has no maximum value, so the pixels follow its height.
        return _short(content, match.end(3) + 1 + (width + 7) // 8 * height, "PBM")
    if match[4] is None:
        return None
    channels, depth = 3 if kind == 6 else 1, 2 if int(match[4]) > 255 else 1
    return _short(content, match.end() + width * height * channels * depth, "PGM or PPM")


def _short(content: bytes, needed: int, kind: str) -> str | None:
    if len(content) >= needed:
        return None
    return f"{_CUT_OFF} after {len(content)} of {needed} bytes (a {kind})"
