"""``objects.csv``: every object in every frame, ordered by passage; and its conversion to ASAM OpenLABEL 1.0."""

from __future__ import annotations

import csv
import heapq
import io
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TextIO, TypeVar

import numpy as np

from laci_stereo.core.errors import OutputError
from laci_stereo.core.world import World
from laci_stereo.monitor.passage import Passage

COLUMNS = (
    "object",
    "frame",
    "timestamp",
    "x",
    "y",
    "yaw",
    "speed",
    "length",
    "width",
    "height",
    "utm_east",
    "utm_north",
    "lane",
)
"""Columns of ``objects.csv``: seconds (Unix), metres, radians and metres per second. x and y are the box's centre, yaw
the direction of its front, in the world frame; lane is the strip along which the passage drove most, or empty."""

NS_PER_S = 1_000_000_000

Content = TypeVar("Content")


@dataclass(frozen=True)
class Row:
    """A line of ``objects.csv``, as far as OpenLABEL needs it; units as in `COLUMNS`."""

    object: int
    frame: int
    timestamp: str
    x: float
    y: float
    yaw: float
    length: float
    width: float
    height: float


def header() -> bytes:
    """Return the first line of ``objects.csv``."""
    return (",".join(COLUMNS) + "\n").encode()


def rows_of(passage: Passage, number: int, lane: str, epoch_ns: int, world: World) -> bytes:
    """Return a passage as lines of ``objects.csv``, with its number and lane; ``epoch_ns`` is the time of frame 0."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    size = [f"{value:.2f}" for value in (passage.length_m, passage.width_m, passage.height_m)]
    utm = world.to_utm(passage.centres)
    for i, frame in enumerate(passage.frames.tolist()):
        stamp_ns = epoch_ns + round(float(passage.stamps_s[i]) * NS_PER_S)
        x, y = passage.centres[i].tolist()
        east, north = utm[i].tolist()
        yaw = float(np.arctan2(np.sin(passage.yaw_rad[i]), np.cos(passage.yaw_rad[i])))
        place = [f"{x:.3f}", f"{y:.3f}", f"{yaw:.4f}", f"{passage.speed_mps[i]:.2f}"]
        seconds = f"{stamp_ns // NS_PER_S}.{stamp_ns % NS_PER_S:09d}"
        writer.writerow([number, frame, seconds, *place, *size, f"{east:.3f}", f"{north:.3f}", lane])
    return text.getvalue().encode()


def read_rows(path: Path) -> Iterator[Row]:
    """Yield the lines of ``objects.csv``.

    Raises
    ------
    OutputError
        If a line is malformed.
    """
    with path.open(newline="", encoding="utf-8") as stream:
        for line in csv.DictReader(stream):
            try:
                yield Row(
                    int(line["object"]),
                    int(line["frame"]),
                    line["timestamp"],
                    *(float(line[name]) for name in ("x", "y", "yaw", "length", "width", "height")),
                )
            except (KeyError, TypeError, ValueError) as problem:
                raise OutputError(f"{path}: a line is {line}; needed are {', '.join(COLUMNS)}") from problem


def by_frame(rows: Iterable[Row], longest_frames: int) -> Iterator[tuple[int, list[Row]]]:
    """Sort the rows of passages, which come in the order of their ends, by frame, in constant memory.

    Parameters
    ----------
    rows : iterable of Row
        One passage after the other, each in the order of frames.
    longest_frames : int
        Greatest number of frames by which a passage can reach back behind the latest end of those before it.

    Yields
    ------
    frame : int
    rows : list of Row
        The objects in this frame.
    """
    waiting: list[tuple[int, int, Row]] = []
    ended = 0

    def ready(until: float) -> Iterator[tuple[int, int, Row]]:
        while waiting and waiting[0][0] < until:
            yield heapq.heappop(waiting)

    def ordered() -> Iterator[tuple[int, int, Row]]:
        nonlocal ended
        for _, passage in groupby(rows, key=lambda row: row.object):
            last = ended
            for row in passage:
                heapq.heappush(waiting, (row.frame, row.object, row))
                last = row.frame
            ended = max(ended, last)
            yield from ready(ended - longest_frames)
        yield from ready(float("inf"))

    for frame, together in groupby(ordered(), key=lambda item: item[0]):
        yield frame, [row for _, _, row in together]


@dataclass(frozen=True)
class Labelled:
    """Metadata of an OpenLABEL file.

    Attributes
    ----------
    name, kind : str
        Name and kind of the sensor.
    uri : str
        Location of its recording.
    world : World
    """

    name: str
    kind: str
    uri: str
    world: World

    @property
    def stream(self) -> str:
        """Name of the sensor's stream: the sensor's name, or its kind where it has none."""
        return self.name or self.kind


def write_openlabel(stream: TextIO, table: Path, longest_frames: int, labelled: Labelled) -> None:
    """Convert ``objects.csv`` to OpenLABEL, a frame at a time.

    Parameters
    ----------
    stream : TextIO
        Where the OpenLABEL is written.
    table : Path
        The ``objects.csv``.
    longest_frames : int
        See `by_frame`.
    labelled : Labelled
    """
    world = labelled.world
    crs = {
        "crs": world.crs,
        "origin_utm": list(world.origin_utm),
        "grid_scale": world.grid_scale,
        "definition": "UTM = origin_utm + grid_scale * (x, y); x east, y north, z above the ground, metres",
    }
    kind = {"stereo": "camera", "lidar": "lidar"}.get(labelled.kind, "other")
    head = {
        "metadata": {"schema_version": "1.0.0", "name": labelled.stream, "coordinate_reference_system": crs},
        "coordinate_systems": {
            "world": {"type": "scene_cs", "parent": "", "children": [], "coordinate_reference_system": crs}
        },
        "streams": {labelled.stream: {"type": kind, "uri": labelled.uri}},
    }
    stream.write('{"openlabel": {\n')
    for name, value in head.items():
        stream.write(f'"{name}": {_json(value)},\n')
    ends: list[int] = []
    stream.write('"objects": ')
    for number, rows in _members(stream, groupby(read_rows(table), key=lambda row: row.object)):
        spans = _spans(row.frame for row in rows)
        ends = [min([spans[0][0], *ends[:1]]), max([spans[-1][1], *ends[1:]])]
        intervals = [{"frame_start": start, "frame_end": end} for start, end in spans]
        stream.write(_json({"name": f"object {number}", "type": "vehicle", "frame_intervals": intervals}))
    stream.write(',\n"frames": ')
    for _, together in _members(stream, by_frame(read_rows(table), longest_frames)):
        stream.write(_json(_frame(together)))
    whole = [{"frame_start": ends[0], "frame_end": ends[1]}] if ends else []
    stream.write(f',\n"frame_intervals": {_json(whole)}\n}}}}\n')


def _members(stream: TextIO, members: Iterable[tuple[int, Content]]) -> Iterator[tuple[int, Content]]:
    """Write a JSON object's braces, commas and names, and yield each member, whose value the caller writes."""
    stream.write("{")
    for number, (name, content) in enumerate(members):
        stream.write(f'{"," if number else ""}\n"{name}": ')
        yield name, content
    stream.write("\n}")


def _json(document: object) -> str:
    return json.dumps(document, allow_nan=False)


def _spans(frames: Iterable[int]) -> list[list[int]]:
    """Return the runs of consecutive frames, each as its first and last frame."""
    spans: list[list[int]] = []
    for frame in frames:
        if spans and frame == spans[-1][1] + 1:
            spans[-1][1] = frame
        else:
            spans.append([frame, frame])
    return spans


def _frame(rows: list[Row]) -> dict[str, object]:
    objects = {}
    for row in rows:
        turn = [row.x, row.y, row.height / 2, 0.0, 0.0, row.yaw, row.length, row.width, row.height]
        shape = {"name": "box", "val": turn, "coordinate_system": "world"}
        objects[str(row.object)] = {"object_data": {"cuboid": [shape]}}
    return {"frame_properties": {"timestamp": rows[0].timestamp}, "objects": objects}
