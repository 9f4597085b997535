"""LibLZF's compression, used by PCD files."""

from __future__ import annotations

LARGEST_RATIO = 88
"""Three bytes encode at most 264."""


def decompress(packed: bytes | memoryview, size: int) -> bytes:
    """Decompress LZF data to a result of ``size`` bytes.

    Raises
    ------
    ValueError
        If ``packed`` is not valid LZF data of this size.
    """
    packed = bytes(packed)
    end = len(packed)
    if not size <= LARGEST_RATIO * end:
        raise ValueError(f"{end} compressed bytes cannot stand for {size}")
    result = bytearray()
    at = 0
    try:
        while at < end:
            control = packed[at]
            at += 1
            if control < 32:  # a run of literal bytes
                result += packed[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += packed[at]
                at += 1
            length += 2
            start = len(result) - ((control & 31) << 8) - packed[at] - 1
            at += 1
            if start < 0 or len(result) + length > size:
                raise ValueError("a reference leads out of the data")
            found = result[start : start + length]
            # A reference may overlap its own output: its bytes then repeat.
            result += found if len(found) == length else (found * (length // len(found) + 1))[:length]
    except IndexError:
        raise ValueError("the data end within a reference") from None
    if at != end or len(result) != size:
        raise ValueError(f"{len(result)} bytes found, {size} needed")
    return bytes(result)
