"""Files that are written as a whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from laci_stereo.core.errors import OutputError
from laci_stereo.io.output import check_files, make_folder, write_file


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


def test_files_that_cannot_be_written_are_named_before_any_work(tmp_path: Path) -> None:
    there, new = tmp_path / "there.csv", tmp_path / "new.csv"
    there.write_text("stays")
    check_files([new], overwrite=False)
    check_files([there, new], overwrite=True)
    for paths, overwrite, message in (
        ([new, there], False, r"there\.csv: exists already; needed is another name, or --overwrite"),
        ([tmp_path], True, "is a folder; needed is the name of a file"),
        ([tmp_path / "no" / "f.csv"], False, "its folder does not exist; needed is one that does"),
        ([new, tmp_path / "." / "new.csv"], False, "is asked for twice; needed is a name for each file"),
    ):
        with pytest.raises(OutputError, match=message):
            check_files(paths, overwrite=overwrite)


def test_a_link_to_a_folder_is_no_file(tmp_path: Path) -> None:
    (tmp_path / "result").mkdir()
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "result")
    with pytest.raises(OutputError, match="link: is a folder"):
        check_files([link], overwrite=True)


def test_a_folder_is_not_made_where_a_file_is(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"file: cannot be made \(File exists\); needed is a folder"):
        make_folder(tmp_path / "file")
