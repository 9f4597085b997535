from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.core.detections import DetectionLog
from laci_stereo.core.errors import DetectionError
from laci_stereo.io.detections import read_detections
from laci_stereo.io.stamps import iso_text
from tests.detections import Rows
from tests.io.support import fuzz, mutations, noise, read_or_refused

FIRST_NS = 1_760_000_000_100_000_000
HEADER = ["timestamp", "x", "y", "z", "yaw", "length", "width", "height", "track_id", "radial_speed", "score", "class"]


def rows(n: int = 20) -> Rows:
    """One car that drives away, seen ten times a second."""
    return Rows(
        list(HEADER),
        [
            [
                stamp_of(i),
                *(f"{value:.3f}" for value in (10.0 + i, -2.0 + 0.1 * i, -5.0, 0.1 + 0.05 * i, 4.4, 1.8, 1.5)),
                *("7", "8.5", "0.9", "car"),
            ]
            for i in range(n)
        ],
    )


def stamp_of(i: int) -> str:
    return f"{(FIRST_NS + i * 10**8) / 1e9:.1f}"


def changed(column: str, value: str, count: int, n: int = 20) -> Rows:
    """Put a value into the first rows."""
    made = rows(n)
    place = made.header.index(column)
    made.column(column, [value if i < count else row[place] for i, row in enumerate(made.rows)])
    return made


def same(one: DetectionLog, other: DetectionLog) -> bool:
    return all(np.array_equal(value, vars(other)[name], equal_nan=True) for name, value in vars(one).items())


def test_every_column_is_read(tmp_path: Path) -> None:
    recorded = read_detections(rows().write(tmp_path / "d.csv"))
    log = recorded.log
    i = np.arange(20)
    assert log.stamps_ns.tolist() == [FIRST_NS + k * 10**8 for k in range(20)]
    assert log.points_sensor == pytest.approx(np.column_stack([10.0 + i, -2.0 + 0.1 * i, np.full(20, -5.0)]))
    assert log.yaw_rad == pytest.approx(0.1 + 0.05 * i)
    assert (log.length_m == 4.4).all()
    assert (log.width_m == 1.8).all()
    assert (log.above_ground_m == 0.75).all()
    assert len(set(log.track_id)) == 1
    assert log.track_id[0] >= 0
    assert (log.radial_mps == 8.5).all()
    assert recorded.notes == ("columns not used: score, class",)


def test_place_and_time_suffice(tmp_path: Path) -> None:
    whole = read_detections(rows().write(tmp_path / "whole.csv")).log
    few = rows().without(*HEADER[3:])
    recorded = read_detections(few.write(tmp_path / "few.csv"))
    assert np.array_equal(recorded.log.points_sensor[:, :2], whole.points_sensor[:, :2])
    for unknown in (recorded.log.points_sensor[:, 2], recorded.log.yaw_rad, recorded.log.length_m):
        assert np.isnan(unknown).all()
    assert (recorded.log.track_id == -1).all()
    assert not recorded.log.is_box().any()
    assert recorded.notes == ("no track_id; detections are linked by their motion",)


SPELLINGS: dict[str, Callable[[Rows], str]] = {
    "semicolons and decimal commas": lambda made: made.text(";").replace(".", ","),
    "tabs": lambda made: made.text("\t"),
    "byte order mark": lambda made: "\ufeff" + made.text(),
    "carriage returns": lambda made: made.text().replace("\n", "\r\n"),
    "blank lines": lambda made: made.text().replace("\n", "\n\n"),
    "capitals and spaces": lambda made: made.text().replace("track_id", " Track ID ").replace("x,y", "X, Y"),
    "other names": lambda made: made.renamed({"timestamp": "t", "x": "pos_x", "width": "w", "track_id": "id"}).text(),
    "another order of columns": lambda made: Rows(made.header[::-1], [row[::-1] for row in made.rows]).text(),
}


@pytest.mark.parametrize("name", list(SPELLINGS))
def test_spellings_of_one_log(tmp_path: Path, name: str) -> None:
    path = tmp_path / "spelled.csv"
    path.write_text(SPELLINGS[name](rows()), encoding="utf-8", newline="")
    assert same(read_detections(path).log, read_detections(rows().write(tmp_path / "d.csv")).log)


@pytest.mark.parametrize("per_s", [10**3, 10**6, 10**9, None])
def test_times_in_any_unit(tmp_path: Path, per_s: int | None) -> None:
    made = rows()
    stamps = [FIRST_NS + i * 10**8 for i in range(20)]
    made.column("timestamp", [iso_text(ns) if per_s is None else str(ns * per_s // 10**9) for ns in stamps])
    assert read_detections(made.write(tmp_path / "d.csv")).log.stamps_ns.tolist() == stamps


@pytest.mark.parametrize("title", ["yaw", "yaw_deg"])
@given(st.lists(st.floats(-359.0, 359.0), min_size=20, max_size=20))
@fuzz
def test_yaw_in_degrees_is_told_by_its_range_or_its_title(tmp_path: Path, title: str, yaws: list[float]) -> None:
    made = rows()
    made.column("yaw", yaws)
    recorded = read_detections(made.renamed({"yaw": title}).write(tmp_path / "d.csv"))
    degrees = title == "yaw_deg" or sum(abs(yaw) > 4 * math.pi for yaw in yaws) > 4
    assert any(note.startswith("yaw: degrees (up to ") for note in recorded.notes) == degrees
    assert recorded.log.yaw_rad == pytest.approx(np.radians(yaws) if degrees else np.array(yaws))
    some = any(abs(yaw) > 2 * math.pi for yaw in yaws)
    assert any(note.startswith("yaw: radians, although ") for note in recorded.notes) == (some and not degrees)


def test_a_turn_too_many_leaves_radians_radians(tmp_path: Path) -> None:
    """One that was rounded up, and a tracker's that does not begin anew at a full turn."""
    yaws = np.linspace(0.0, 3 * math.pi, 20).round(2)
    made = rows()
    made.column("yaw", yaws.tolist())
    recorded = read_detections(made.write(tmp_path / "d.csv"))
    assert recorded.log.yaw_rad == pytest.approx(yaws)
    assert any("7 of 20 values exceed a full turn (up to 9.42); degrees need" in note for note in recorded.notes)


def test_numbers_of_rows_are_no_objects(tmp_path: Path) -> None:
    made = rows()
    made.column("track_id", range(20))
    recorded = read_detections(made.write(tmp_path / "d.csv"))
    assert (recorded.log.track_id == -1).all()
    assert any(note.startswith("track_id: not used, as none of its 20 values is there") for note in recorded.notes)
    made.column("track_id", [*range(19), 0])
    assert (read_detections(made.write(tmp_path / "d.csv")).log.track_id >= 0).all()


@pytest.mark.parametrize(
    ("made", "why"),
    [
        (rows(), ""),
        (rows().without("height"), "lacks height"),
        (changed("height", "", 20), "lacks height"),
        (
            changed("height", "150", 20),
            "holds no possible height: height is 150 m in row 2, possible is more than 0 and at most 6 m",
        ),
    ],
    ids=["height", "no column", "no value", "cm"],
)
def test_why_there_is_no_height(tmp_path: Path, made: Rows, why: str) -> None:
    assert read_detections(made.write(tmp_path / "d.csv")).no_height == why


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        ("x", "near", "x is 'near'; needed is a number"),
        ("z", "1e999", "z is '1e999'; needed is a number"),
        ("length", "long", "length is 'long'; needed is a number"),
        ("y", "nan", "y is missing; needed is -1000 to 1000 m from the sensor"),
        ("z", "", "z is missing; needed is -1000 to 1000 m from the sensor"),
        ("x", "569805.5", "x is 569805.5 m; needed is -1000 to 1000 m from the sensor"),
        ("timestamp", "noon", "timestamp is 'noon'; needed is a Unix time in seconds"),
    ],
)
def test_a_bad_row_is_skipped_and_many_are_refused(tmp_path: Path, column: str, value: str, words: str) -> None:
    recorded = read_detections(changed(column, value, 4).write(tmp_path / "d.csv"))
    assert len(recorded.log) == 16
    assert f"4 bad rows skipped, the first of them row 2: {words}" in recorded.notes
    with pytest.raises(DetectionError, match=r"d\.csv, row 2: ") as caught:
        read_detections(changed(column, value, 5).write(tmp_path / "d.csv"))
    assert words in str(caught.value)
    assert "(5 of 20 rows are bad, at most a fifth may be)" in str(caught.value)


@pytest.mark.parametrize(
    ("column", "value"), [("length", "0"), ("width", "-1.8"), ("height", "40"), ("radial_speed", "999")]
)
def test_what_no_vehicle_has_is_missing(tmp_path: Path, column: str, value: str) -> None:
    recorded = read_detections(changed(column, value, 20).write(tmp_path / "d.csv"))
    assert len(recorded.log) == 20
    assert any(note.startswith(f"20 values taken as missing: {column} is {value} ") for note in recorded.notes)
    attribute = {"length": "length_m", "width": "width_m", "height": "above_ground_m", "radial_speed": "radial_mps"}
    assert np.isnan(vars(recorded.log)[attribute[column]]).all()


def test_order_and_repeats(tmp_path: Path) -> None:
    whole = read_detections(rows().write(tmp_path / "d.csv")).log
    made = rows()
    mixed = Rows(made.header, [*made.rows[5:], *made.rows[:5], *made.rows[2:6]])
    recorded = read_detections(mixed.write(tmp_path / "mixed.csv"))
    assert same(recorded.log, whole)
    assert "9 rows out of order sorted" in recorded.notes
    assert "4 doubled rows dropped" in recorded.notes
    unnamed = read_detections(mixed.without("track_id").write(tmp_path / "unnamed.csv"))
    assert len(unnamed.log) == 20


def test_one_object_is_at_one_place_at_a_time(tmp_path: Path) -> None:
    made = rows()
    elsewhere = [[*row[:1], "50.0", *row[2:]] for row in made.rows]
    recorded = read_detections(Rows(made.header, [*made.rows, *elsewhere[:5]]).write(tmp_path / "d.csv"))
    assert len(recorded.log) == 20
    assert "5 rows dropped whose object is elsewhere at the same time" in recorded.notes
    both = Rows(made.header, [*made.rows, *elsewhere])
    with pytest.raises(DetectionError, match=r"timestamp and track_id are those of another row in 20 of 40 rows"):
        read_detections(both.write(tmp_path / "d.csv"))
    # Without a number these are two objects.
    assert len(read_detections(both.without("track_id").write(tmp_path / "d.csv")).log) == 40


def test_names_of_objects_may_be_words(tmp_path: Path) -> None:
    made = rows(6)
    made.column("track_id", ["red car", "red car", "", "blue", "none", "Blue"])
    first, second, third, fourth, fifth, sixth = read_detections(made.write(tmp_path / "d.csv")).log.track_id
    assert (third, fifth) == (-1, -1)
    assert first == second != fourth == sixth
    assert min(first, fourth) >= 0


def test_what_is_no_log(tmp_path: Path) -> None:
    path = tmp_path / "d.csv"
    for content, message in (
        (None, "does not exist"),
        (b"", "is empty"),
        (b"\n \n", "is empty"),
        (b"timestamp,x,y\n", "holds a header but no rows; needed is at least one detection"),
        (b"timestamp,x\n1760000000,3\n", "lacks the column y; needed are timestamp, x, y, it holds timestamp, x"),
        (b"1760000000,3,4\n1760000001,3,4\n", "begins with 1760000000, 3, 4; needed is a header row"),
        (b'[{"timestamp": 1760000000, "x": 3}]', "is JSON; needed is CSV with the columns timestamp, x, y"),
        (b"header:\n  stamp:\n    sec: 3\n", "looks like YAML; needed is CSV with the columns timestamp, x, y"),
        (b"timestamp,x,y\n0.1,3,4\n", ".* if it counts from a recording's begin, add that in Unix time; if it is of"),
        (bytes(range(256)), "is not a text file"),
    ):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(DetectionError, match=rf"d\.csv,? ?{message}"):
            read_detections(path)
    with pytest.raises(DetectionError, match="is a folder; needed is a file"):
        read_detections(tmp_path)


def test_any_file_is_read_or_refused(tmp_path: Path) -> None:
    whole = rows(4).text().encode()
    words = (
        ",".join(HEADER) + "\n",
        "timestamp,x,y\n",
        ",",
        "\n",
        ";",
        '"',
        "1760000000.5",
        "9e9",
        "-1",
        "1e999",
        "\r",
    )

    @fuzz
    @given(st.one_of(mutations(whole), noise(*words)))
    def check(content: bytes) -> None:
        path = tmp_path / "x.csv"
        path.write_bytes(content)
        recorded = read_or_refused(lambda: read_detections(path), DetectionError)
        if recorded is not None:
            assert len(recorded.log) > 0
            assert (np.diff(recorded.log.stamps_ns) >= 0).all()
            assert np.abs(recorded.log.points_sensor[:, :2]).max() <= 1000.0
            assert all("\n" not in note for note in recorded.notes)

    check()
