"""The table of objects, and the same as OpenLABEL."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.core.errors import OutputError
from laci_stereo.monitor.objects import Labelled, Row, by_frame, header, read_rows, rows_of, write_openlabel
from laci_stereo.monitor.passage import Passage
from tests.monitor.support import WORLD

EPOCH_NS = 1_700_000_000_123_456_789


def passage(first: int, count: int, gap: bool = False) -> Passage:
    frames = first + np.arange(count) * (2 if gap else 1)
    along = np.arange(count, dtype=np.float64)
    yaw = np.linspace(3.0, 3.5, count)
    return Passage(frames, frames / 10, np.column_stack([along, -along]), yaw, along, 4.5, 1.8, 1.5)


def write_table(path: Path, *passages: Passage) -> None:
    lines = [rows_of(one, number, "5", EPOCH_NS, WORLD) for number, one in enumerate(passages, start=1)]
    path.write_bytes(header() + b"".join(lines))


def label(path: Path, longest: int = 100) -> dict:  # type: ignore[type-arg]
    stream = io.StringIO()
    write_openlabel(stream, path, longest, Labelled("mast", "stereo", "left", WORLD))
    read: dict = json.loads(stream.getvalue())["openlabel"]  # type: ignore[type-arg]
    return read


def test_table_keeps_positions_and_times(tmp_path: Path) -> None:
    write_table(tmp_path / "objects.csv", passage(7, 12))
    rows = list(read_rows(tmp_path / "objects.csv"))
    assert [row.frame for row in rows] == list(range(7, 19))
    assert rows[0].timestamp == "1700000000.823456789"
    assert [row.x for row in rows] == [float(i) for i in range(12)]
    assert all(-np.pi <= row.yaw <= np.pi for row in rows)


def test_openlabel_holds_every_object_in_its_frames(tmp_path: Path) -> None:
    write_table(tmp_path / "objects.csv", passage(3, 4), passage(1, 6, gap=True), passage(20, 2))
    found = label(tmp_path / "objects.csv")
    assert found["metadata"]["schema_version"] == "1.0.0"
    assert found["metadata"]["coordinate_reference_system"]["crs"] == "EPSG:32632"
    assert found["coordinate_systems"]["world"]["parent"] == ""
    assert found["streams"]["mast"]["type"] == "camera"
    assert found["objects"]["1"]["frame_intervals"] == [{"frame_start": 3, "frame_end": 6}]
    assert len(found["objects"]["2"]["frame_intervals"]) == 6
    assert [int(frame) for frame in found["frames"]] == [1, 3, 4, 5, 6, 7, 9, 11, 20, 21]
    assert set(found["frames"]["5"]["objects"]) == {"1", "2"}
    assert found["frame_intervals"] == [{"frame_start": 1, "frame_end": 21}]
    (cuboid,) = found["frames"]["21"]["objects"]["3"]["object_data"]["cuboid"]
    x, y, z, roll, pitch, _, length, width, height = cuboid["val"]
    assert (x, y, z, roll, pitch, length, width, height) == (1.0, -1.0, 0.75, 0.0, 0.0, 4.5, 1.8, 1.5)
    assert cuboid["coordinate_system"] == "world"


def test_empty_table_is_an_empty_file(tmp_path: Path) -> None:
    write_table(tmp_path / "objects.csv")
    found = label(tmp_path / "objects.csv")
    assert found["objects"] == found["frames"] == {}
    assert found["frame_intervals"] == []


def test_damaged_table_is_named(tmp_path: Path) -> None:
    (tmp_path / "objects.csv").write_bytes(header() + b"1,x,2\n")
    with pytest.raises(OutputError, match=r"objects\.csv: a line is"):
        list(read_rows(tmp_path / "objects.csv"))


@st.composite
def ended(draw: st.DrawFn) -> list[tuple[int, int]]:
    """Passages of up to 20 frames, as first and last frame, by their ends to within 5 frames."""
    spans = draw(st.lists(st.tuples(st.integers(0, 300), st.integers(0, 19)), max_size=40))
    late = draw(st.lists(st.integers(0, 5), min_size=len(spans), max_size=len(spans)))
    order = sorted(range(len(spans)), key=lambda i: sum(spans[i]) + late[i])
    return [(spans[i][0], sum(spans[i])) for i in order]


@given(ended())
def test_frames_come_in_order_and_whole(spans: list[tuple[int, int]]) -> None:
    def rows() -> Iterator[Row]:
        for number, (first, last) in enumerate(spans):
            for frame in range(first, last + 1):
                yield Row(number, frame, "0", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    found = dict(by_frame(rows(), 25))
    assert list(found) == sorted({frame for first, last in spans for frame in range(first, last + 1)})
    for frame, together in found.items():
        assert [row.object for row in together] == [n for n, (a, b) in enumerate(spans) if a <= frame <= b]
