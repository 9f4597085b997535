"""``laci-stereo export``: a calibration in the format of another tool."""

from __future__ import annotations

from pathlib import Path

import click

from laci_stereo.commands.options import PATH, say_written
from laci_stereo.core.errors import SettingError
from laci_stereo.io.output import check_files, make_folder, write_file
from laci_stereo.io.result.exports import FORMATS, ExportedFile, export_as
from laci_stereo.io.result.stored_calibration import read_calibration


@click.command()
@click.argument("calibration", type=PATH, required=False)
@click.option("--to", "form", type=click.Choice([each.name for each in FORMATS]), help="Format; see --list.")
@click.option("--out", type=PATH, help="File, or folder where there are several [default: standard output].")
@click.option("--overwrite", is_flag=True, help="Replace files that are there already.")
@click.option("--list", "listing", is_flag=True, help="Say what each format is.")
def export(calibration: Path | None, form: str | None, out: Path | None, overwrite: bool, listing: bool) -> None:
    """Write a calibration for another tool.

    CALIBRATION is a result folder or its calibration.json. Every file says in words which way its transform leads,
    between which frames, and in which unit.
    """
    if listing:
        click.echo("\n".join(f"{each.name:<11}{each.meaning}" for each in FORMATS))
        return
    if calibration is None or form is None:
        raise SettingError("nothing to write; needed are a CALIBRATION and --to FORMAT, or --list")
    files = export_as(read_calibration(calibration), form)
    if out is None:
        click.echo(_only(files).text, nl=False)
        return
    paths = [out] if len(files) == 1 and not out.is_dir() else [out / file.name for file in files]
    if len(files) > 1:
        make_folder(out)
    check_files(paths, overwrite=overwrite)
    for path, file in zip(paths, files, strict=True):
        write_file(path, file.text.encode())
    say_written(*paths, err=True)


def _only(files: tuple[ExportedFile, ...]) -> ExportedFile:
    if len(files) > 1:
        raise SettingError(
            f"there are {len(files)} files, {', '.join(each.name for each in files)}; needed is --out DIR"
        )
    return files[0]
