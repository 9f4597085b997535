"""Result folders and files that are written completely or not at all."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path

from laci_stereo.core.errors import OutputError

RESULT_FILE = "calibration.json"
"""The file that marks a folder as a result; no other folder is ever replaced."""

EVIDENCE_FILE = "evidence.npz"
"""The data of a result's drive, from which it can be estimated again together with others."""

RESULT_FILES = (RESULT_FILE, EVIDENCE_FILE, "check.png", "overlay_*.png", "report.html", "topdown.png")
"""All files of a result; a folder with other files is not replaced either, since these would be lost."""


def check_output(out: Path, *, overwrite: bool) -> None:
    """Check before any work is done that the result can be written.

    Raises
    ------
    OutputError
        If ``out`` exists and must not be replaced, or its parent folder is not writable.
    """
    try:
        if out.exists() or out.is_symlink():
            _check_replaceable(out, overwrite=overwrite)
        parent = _existing_parent(out)
        with tempfile.TemporaryFile(dir=parent):
            pass
    except OSError as error:
        raise OutputError(
            f"{out}: cannot be written ({error.strerror}); needed is a folder that can be made and written to"
        ) from error


def _check_replaceable(out: Path, *, overwrite: bool) -> None:
    if not out.is_dir() or out.is_symlink():
        raise OutputError(f"{out}: is not a folder; needed is a folder that does not exist yet")
    if os.path.ismount(out):  # pathlib has it for Windows from Python 3.12
        raise OutputError(f"{out}: is a mount point, which cannot be renamed; needed is a folder below it")
    names = sorted(path.name for path in out.iterdir())
    if not names:
        return
    if RESULT_FILE not in names:
        raise OutputError(f"{out}: holds other files and no {RESULT_FILE}; needed is a folder that does not exist yet")
    foreign = [name for name in names if not any(fnmatch(name, pattern) for pattern in RESULT_FILES)]
    if foreign:
        raise OutputError(f"{out}: holds {foreign[0]}, which is no part of a result; needed is another --out")
    if not overwrite:
        raise OutputError(f"{out}: holds a result already; needed is another --out, or --overwrite to replace it")


def check_files(paths: Iterable[Path | None], *, overwrite: bool) -> None:
    """Check before any work is done that files can be written; None: none was asked for.

    Raises
    ------
    OutputError
        If a file exists already, is a folder, is in no existing folder, or is named twice.
    """
    known: set[Path] = set()
    for path in filter(None, paths):
        if path.is_dir():
            raise OutputError(f"{path}: is a folder; needed is the name of a file")
        if path.exists() and not overwrite:
            raise OutputError(f"{path}: exists already; needed is another name, or --overwrite to replace it")
        if not path.absolute().parent.is_dir():
            raise OutputError(f"{path}: its folder does not exist; needed is one that does")
        if path.resolve() in known:
            raise OutputError(f"{path}: is asked for twice; needed is a name for each file")
        known.add(path.resolve())


def check_png(picture: Path | None) -> None:
    """Raise if the file name of a picture that was asked for does not end in ``.png``.

    Raises
    ------
    OutputError
    """
    if picture is not None and picture.suffix.lower() != ".png":
        raise OutputError(f"{picture}: the picture's name ends in {picture.suffix or 'nothing'}; needed is .png")


def make_folder(folder: Path) -> None:
    """Make a folder, with its parents, unless it exists.

    Raises
    ------
    OutputError
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made ({error.strerror}); needed is a folder") from error


def write_file(path: Path, content: bytes) -> None:
    """Write a file completely, or leave the previous one unchanged.

    Raises
    ------
    OutputError
    """
    with whole_file(path) as temporary:
        temporary.write_bytes(content)


def write_document(path: Path, document: Mapping[str, object]) -> None:
    """Write a JSON file completely, or leave the previous one unchanged.

    Raises
    ------
    OutputError
    """
    write_file(path, (json.dumps(document, indent=2, allow_nan=False) + "\n").encode())


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary file beside ``path`` that replaces it if the block succeeds; else ``path`` stays unchanged.

    Raises
    ------
    OutputError
    """
    try:
        with tempfile.NamedTemporaryFile(dir=path.absolute().parent, prefix=f".{path.name}.", delete=False) as stream:
            temporary = Path(stream.name)
        try:
            yield temporary
            temporary.chmod(0o644)  # temporary files are accessible by the user only
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror}); nothing was changed") from error


def _existing_parent(out: Path) -> Path:
    parent = out.absolute().parent
    while not parent.exists():
        parent = parent.parent
    return parent


@contextmanager
def result_folder(out: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary folder beside ``out`` that takes its place if the block succeeds.

    On any error in the block, the temporary folder is removed, and the previous content of ``out`` stays.

    Raises
    ------
    OutputError
        As in `check_output`, or if writing fails, for instance on a full disk.
    """
    check_output(out, overwrite=overwrite)
    out = out.absolute()
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
        try:
            yield temporary
            temporary.chmod(0o755)  # mkdtemp's folders are accessible by the user only
            _take_place(temporary, out)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written ({error.strerror}); nothing was changed") from error


def _take_place(temporary: Path, out: Path) -> None:
    """Rename the new result to ``out``, with the previous one set aside until the new one is in place."""
    if not out.exists():
        temporary.rename(out)
        return
    aside = Path(tempfile.mkdtemp(prefix=f".{out.name}.old.", dir=out.parent))
    try:
        out.rename(aside / out.name)
        temporary.rename(out)
    finally:  # an interrupt can occur between any two lines
        if not out.exists():
            (aside / out.name).rename(out)
        shutil.rmtree(aside, ignore_errors=True)
