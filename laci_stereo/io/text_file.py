"""Reading text files, and quoting their content in one line of an error message."""

from __future__ import annotations

import codecs
import re
from collections.abc import Mapping
from pathlib import Path

from laci_stereo.core.errors import InputError
from laci_stereo.io.file_content import read_content

_LONGEST_QUOTE = 60
_LONGEST_LIST = 500
_MOST_LETTERS = 0.1
"""Largest fraction of a text that is not ASCII, but taken for text nevertheless."""

_OTHERS: Mapping[bytes, str] = {
    b"PK\x03\x04": "a ZIP archive, as .xlsx and .npz are; needed is its content as text, unpacked or saved as CSV",
    b"\xd0\xcf\x11\xe0": "an Excel workbook; needed is its sheet, saved as CSV",
    b"PAR1": "a Parquet file; needed is its table as CSV (pandas: read_parquet, to_csv)",
    b"\x93NUMPY": "an array of NumPy; needed is a text file (numpy.savetxt)",
    b"BZh": "packed by bzip2; needed is it unpacked, or packed by gzip",
    b"\xfd7zXZ": "packed by xz; needed is it unpacked, or packed by gzip",
    b"\x28\xb5\x2f\xfd": "packed by zstd; needed is it unpacked, or packed by gzip",
    b"7z\xbc\xaf": "a 7-Zip archive; needed is what is in it, unpacked",
    b"%PDF": "a PDF document; needed is a text file",
    b"<!DOCTYPE html": "a web page, as of a log-in; needed is the file itself",
    b"<html": "a web page, as of a log-in; needed is the file itself",
}
"""What files begin with that are taken for text in error, what they are, and the remedy."""

_CONTROL = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]")
_UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text(path: Path, error: type[InputError]) -> str:
    """Return the text of a UTF-8 file, or a UTF-16 file with a byte order mark, without that mark; gzip is unpacked.

    A few other letters, such as degree signs and umlauts of spreadsheets, are read as those of Windows-1252.

    Raises
    ------
    InputError
        Of the class ``error``, if the file is missing, a folder, empty, unreadable or not text.
    """
    return text_in(read_content(path, error), path, error)


def text_in(content: bytes, path: Path, error: type[InputError]) -> str:
    """Return the text in the content of a file, as `read_text` does.

    Raises
    ------
    InputError
        Of the class ``error``, if it is empty or not text.
    """
    other = next((words for magic, words in _OTHERS.items() if content[: len(magic)].lower() == magic.lower()), None)
    if other is not None:
        raise error(f"{path} is {other}")
    try:
        text = content.decode("utf-16" if content.startswith(_UTF16_MARKS) else "utf-8-sig")
    except UnicodeDecodeError as problem:
        if _is_windows_text(content):
            return content.decode("cp1252", errors="replace")
        byte = f"byte {problem.start} is 0x{content[problem.start]:02x}"
        raise error(f"{path} is not a text file: {byte}; needed is UTF-8 text") from problem
    if not text.strip():
        raise error(f"{path} is empty ({len(content)} bytes); needed is a text file")
    if "\0" in text:
        raise error(f"{path} is not a text file: character {text.index(chr(0))} is NUL; needed is UTF-8 text")
    return text


def _is_windows_text(content: bytes) -> bool:
    letters = sum(byte >= 0x80 for byte in content)
    return letters <= _MOST_LETTERS * len(content) and not _CONTROL.search(content)


def quoted(text: str) -> str:
    """Return text from a file in quotes, on one line, shortened."""
    return repr(shortened(text, _LONGEST_QUOTE))


def shortened(text: str, most: int = 300) -> str:
    """Return a message that may contain text from a file on one line, shortened."""
    shown = re.sub(r"\s+", " ", text)
    return shown if len(shown) <= most else shown[: most - 3] + "..."


def listed(texts: list[str], most: int = 20) -> str:
    """Return the first few of several texts from a file, separated by commas, on one line, shortened."""
    more = f" and {len(texts) - most} more" if len(texts) > most else ""
    return shortened(", ".join(text[:_LONGEST_QUOTE] for text in texts[:most]), _LONGEST_LIST) + more
