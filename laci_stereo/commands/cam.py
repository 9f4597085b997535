"""``laci-stereo cam``: the content of a log of messages, as words, a map, or another format."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal, TypeAlias

import click

from laci_stereo.commands.options import PATH, say_written
from laci_stereo.commands.program import NEGATIVE
from laci_stereo.io.cam.export import to_csv, to_geojson
from laci_stereo.io.cam.log import read_cam_log
from laci_stereo.io.cam.recording import CamRecording
from laci_stereo.io.images import write_picture
from laci_stereo.io.output import check_files, check_png, write_file
from laci_stereo.report.cam_map import draw_log
from laci_stereo.report.cam_summary import summarise_log

Format: TypeAlias = Literal["csv", "geojson"]

_WRITERS: Mapping[Format, Callable[[CamRecording], str]] = {
    "csv": lambda recording: to_csv(recording.log, of_antenna=recording.is_receiver),
    "geojson": lambda recording: to_geojson(recording.log),
}


@click.command()
@click.argument("log", type=PATH)
@click.option("--to", "form", type=click.Choice(["csv", "geojson"]), help="Convert, to standard output or into --out.")
@click.option("--out", type=PATH, help="File for the conversion; without --to, for a map (PNG).")
@click.option("--overwrite", is_flag=True, help="Replace a file that is there already.")
def cam(log: Path, form: Format | None, out: Path | None, overwrite: bool) -> None:
    """Show what a log of messages says, and whether a run could use it, or convert it.

    LOG is CSV, a packet capture (pcap, pcapng), a ROS or MCAP bag, lines of hexadecimal CAMs, JSON, NMEA, GPX or
    RTKLIB's .pos; its content tells which.

    Exit codes: 0 a run could use it, or it was converted; 1 it could use none of its stations; 2 it cannot be read.
    """
    check_files([out], overwrite=overwrite)
    if form is None:
        check_png(out)
    recording = read_cam_log(log)
    if form is None:
        summary = summarise_log(recording, str(log))
        click.echo(summary.text)
        if out is not None:
            write_picture(out, draw_log(recording))
            say_written(out)
        if not summary.of_use:
            sys.exit(NEGATIVE)
        return
    for note in recording.notes:
        click.echo(f"note: {note}", err=True)
    text = _WRITERS[form](recording)
    if out is None:
        click.echo(text, nl=False)
    else:
        write_file(out, text.encode())
        say_written(out, err=True)
