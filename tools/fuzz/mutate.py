"""Mutations of files that imitate damage by disks, networks, editors and attackers."""

from __future__ import annotations

import gzip
import io
import random
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from operator import xor
from typing import TypeAlias

Files: TypeAlias = Mapping[str, bytes]
"""The input of a reader: contents by path within a folder."""

_Change: TypeAlias = Callable[[bytes], bytes]

MOST_BYTES = 1 << 20
"""Largest size of an input; larger inputs would only take longer."""

_NUMBERS = (
    *(b"0", b"-1", b"-0.0", b"nan", b"inf", b"1e400", b"1e308", b"1e-320", b"2147483648", b"4294967295"),
    *(b"9223372036854775808", b"999999999999", b"1" * 400, b"0x7f", b"", b"1,5", b"\xd9\xa3"),
    *(b"NaN", b"-Infinity", b".nan", b"-.inf", b"null", b"true", b"[]", b"{}", b'""', b"[[1]]"),
)
_TEXTS = (b"'x\\ny'", b'"\\n\\u0000"', b'"\\ud800"', b'"' + b"x" * 3000 + b'"', b'"a/../../b"')
_BINARY = tuple(
    struct.pack(order + kind, value)
    for order in "<>"
    for kind, values in {
        "H": (0, 0x7FFF, 0xFFFF),
        "I": (0, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x10000000),
        "Q": (0, 1 << 31, (1 << 63) - 1, 1 << 63, (1 << 64) - 1),
        "f": (float("nan"), float("inf"), 3e38),
        "d": (float("nan"), float("-inf"), 1e308),
    }.items()
    for value in values
)
_NO_UTF8 = (b"\xff", b"\xc0\x80", b"\xed\xa0\x80", b"\xfe\xff", b"\x00", b"\xe2\x80\xa8", b"\x85", b"\xef\xbb\xbf")
_NESTED = (b"[", b"{", b"(", b'{"a":', b"<a>", b"- ", b" ", b"'", b'"')
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
_QUOTED = re.compile(rb"\"[^\"\n]*\"|'[^'\n]*'")
_WORD = re.compile(rb"[A-Za-z_][A-Za-z_0-9]*")
_SENTENCE = re.compile(rb"\$([^*\r\n]*)\*[0-9A-F]{2}")


def mutated(files: Files, others: Sequence[bytes], rng: random.Random) -> dict[str, bytes]:
    """Return a reader's files, one of them with one to four mutations.

    Parameters
    ----------
    files : Files
    others : sequence of bytes
        Contents of other files, parts of which are spliced in.
    rng : random.Random
    """
    found = dict(files)
    name = rng.choice(sorted(found))
    found[name] = _damaged(found[name], rng.choice(others), rng)
    return found


def _damaged(data: bytes, other: bytes, rng: random.Random) -> bytes:
    """Damage a file; of a container, in three cases of four its contents, as wrong checksums would end the reading."""
    rebuild = next((build for magic, build in _CONTAINERS if data.startswith(magic)), None)
    if rebuild is not None and rng.random() < 0.75:
        return rebuild(data, lambda inner: _damaged(inner, other, rng), rng)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 4))):
        data = rng.choice(_DAMAGES)(data, other, rng)[:MOST_BYTES]
    return data


def _slice(data: bytes, rng: random.Random) -> tuple[int, int]:
    start = rng.randrange(len(data) + 1)
    return start, min(len(data), start + int(2 ** rng.uniform(0, 14)))


def _flip(data: bytes, _other: bytes, rng: random.Random) -> bytes:
    flipped = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        if flipped:
            flipped[rng.randrange(len(flipped))] ^= 1 << rng.randrange(8)
    return bytes(flipped)


def _truncate(data: bytes, _other: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _insert(data: bytes, _other: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.randbytes(rng.randrange(1, 20)) + data[at:]


def _duplicate(data: bytes, _other: bytes, rng: random.Random) -> bytes:
    start, end = _slice(data, rng)
    return data[:end] + data[start:end] * rng.choice((1, 1, 3)) + data[end:]


def _delete(data: bytes, _other: bytes, rng: random.Random) -> bytes:
    start, end = _slice(data, rng)
    return data[:start] + data[end:]


def _splice(data: bytes, other: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data) + 1)] + other[rng.randrange(len(other) + 1) :]


def _number(data: bytes, _other: bytes, rng: random.Random) -> bytes:
    return _replaced(data, _NUMBER, rng.choice(_NUMBERS), rng)


def _quoted(data: bytes, _other: bytes, rng: random.Random) -> bytes:
    return _replaced(data, _QUOTED, rng.choice(_NUMBERS + _TEXTS), rng)


def _binary(data: bytes, _other: bytes, rng: random.Random) -> bytes:
    # Headers are at the beginning, so half of the numbers are placed there.
    at = rng.randrange(min(len(data), rng.choice((256, MOST_BYTES))) + 1)
    value = rng.choice(_BINARY)
    return data[:at] + value + data[at + len(value) :]


def _keyword(data: bytes, other: bytes, rng: random.Random) -> bytes:
    words = _WORD.findall(rng.choice((data, other)))
    return _replaced(data, _WORD, rng.choice(words), rng) if words else data


def _replaced(data: bytes, what: re.Pattern[bytes], by: bytes, rng: random.Random) -> bytes:
    places = [match.span() for match in what.finditer(data)]
    if not places:
        return data
    start, end = rng.choice(places)
    return data[:start] + by + data[end:]


def _repeat_line(data: bytes, _other: bytes, rng: random.Random) -> bytes:
    lines = data.splitlines(keepends=True)
    if not lines:
        return data
    at = rng.randrange(len(lines))
    lines[at] *= min(rng.choice((2, 2, 5, 500)), 2 + MOST_BYTES // len(lines[at]))
    return b"".join(lines)


def _no_utf8(data: bytes, _other: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.choice(_NO_UTF8) + data[at:]


def _nest(data: bytes, _other: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.choice(_NESTED) * rng.choice((1, 20, 2000, 50_000)) + data[at:]


def _wrap(data: bytes, _other: bytes, _rng: random.Random) -> bytes:
    return gzip.compress(data, 1, mtime=0)


_DAMAGES: tuple[Callable[[bytes, bytes, random.Random], bytes], ...] = (
    *(_flip, _truncate, _insert, _duplicate, _delete, _splice, _number, _number, _quoted, _binary, _binary),
    *(_keyword, _repeat_line, _no_utf8, _nest, _wrap),
)


def _in_gzip(data: bytes, change: _Change, _rng: random.Random) -> bytes:
    return gzip.compress(change(gzip.decompress(data)), 1, mtime=0)


def _in_zip(data: bytes, change: _Change, rng: random.Random) -> bytes:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    chosen = rng.choice(sorted(members))
    members[chosen] = change(members[chosen])
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def _in_png(data: bytes, change: _Change, _rng: random.Random) -> bytes:
    """Damage a PNG's header and compressed pixels, and correct the checksums."""
    at, parts = 8, [data[:8]]
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        if kind in (b"IHDR", b"IDAT"):
            body = change(body)
        parts.append(struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)))
        at += 12 + length
    return b"".join(parts)


def _in_sentences(data: bytes, change: _Change, _rng: random.Random) -> bytes:
    """Damage NMEA sentences, and correct the checksums."""
    # A byte in front of the mark that identifies a container prevents the change from coming here again.
    return _SENTENCE.sub(lambda found: b"$%s*%02X" % (found[1], reduce(xor, found[1], 0)), change(b"\n" + data))


_CONTAINERS: tuple[tuple[bytes, Callable[[bytes, _Change, random.Random], bytes]], ...] = (
    (b"\x1f\x8b", _in_gzip),
    (b"PK\x03\x04", _in_zip),
    (b"\x89PNG", _in_png),
    (b"$", _in_sentences),
)
