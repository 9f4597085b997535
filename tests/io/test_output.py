"""Files that are written as a whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from laci_stereo.core.errors import OutputError
from laci_stereo.io.output import write_file


def test_what_cannot_take_its_place_leaves_nothing_behind(tmp_path: Path) -> None:
    taken = tmp_path / "table.csv"
    taken.mkdir()
    with pytest.raises(OutputError, match=r"table\.csv: cannot be written \(.+\); nothing was changed"):
        write_file(taken, b"new")
    assert list(tmp_path.iterdir()) == [taken]


def test_a_file_is_replaced_as_a_whole(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(b"old and longer")
    write_file(path, b"new")
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]
