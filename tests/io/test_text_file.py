"""What stands in a file is quoted within one short line, whatever it is."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.core.errors import CamError
from laci_stereo.io.text_file import listed, quoted, read_text, shortened

LONG = st.one_of(st.text(), st.text(min_size=1).map(lambda text: 5000 * text))


@given(st.lists(LONG, max_size=30), st.integers(3, 400))
def test_no_quotation_is_long_or_of_several_lines(texts: list[str], most: int) -> None:
    assert len(listed(texts)) < 600
    assert len(listed(texts).splitlines()) <= 1
    for text in texts:
        assert len(shortened(text, most)) <= most
        assert len(shortened(text, most).splitlines()) <= 1
        assert len(quoted(text).splitlines()) == 1


def test_short_words_stay_as_they_are() -> None:
    assert shortened("three words, two commas,") == "three words, two commas,"
    assert shortened("a" * 400, 10) == "aaaaaaa..."
    assert listed(["x", "y z"]) == "x, y z"
    assert listed(["x"] * 22) == ", ".join(["x"] * 20) + " and 2 more"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"PK\x03\x04\x14\0\xff", r"a ZIP archive, as \.xlsx .* saved as CSV"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1", r"an Excel workbook; needed is its sheet, saved as CSV"),
        (b"PAR1\x15\0", r"a Parquet file"),
        (b"\xfd7zXZ\0", r"packed by xz; needed is it unpacked"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:1\n", r"a pointer of Git LFS, .* \(git lfs pull\)"),
        (b"<!doctype HTML><html></html>", r"a web page"),
    ],
)
def test_what_a_file_is_instead_of_text_is_named(tmp_path: Path, content: bytes, said: str) -> None:
    (tmp_path / "log").write_bytes(content)
    with pytest.raises(CamError, match=said):
        read_text(tmp_path / "log", CamError)


def test_letters_of_windows_are_read_and_bytes_are_not(tmp_path: Path) -> None:
    path = tmp_path / "cam.csv"
    text = "Zeit;Länge [m];Richtung [°]\r\n1;4,70;90\r\n"
    for encoding in ("cp1252", "utf-8", "utf-8-sig", "utf-16"):
        path.write_bytes(text.encode(encoding))
        assert read_text(path, CamError) == text
    for content in (b"\xe4\xf6\xfc", b"a lot of text with a byte of control \x01 and \xe4", b"\x00\xe4" + 99 * b"a"):
        path.write_bytes(content)
        with pytest.raises(CamError, match=r"cam\.csv is not a text file: byte .* needed is UTF-8 text"):
            read_text(path, CamError)
