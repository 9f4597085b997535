from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.core.errors import ImageError, MapError
from laci_stereo.io.images import IMAGES
from laci_stereo.io.timed_files import FileKind, folder_stamps, in_time, names_in
from tests.io.support import fuzz, noise, read_or_refused

UNIX_NS = st.integers(10**17, 4 * 10**18)


def fixed(value_ns: int, decimals: int = 9) -> str:
    return f"{value_ns // 10**9}.{value_ns % 10**9:09d}"[: 11 + decimals]


@fuzz
@given(st.lists(UNIX_NS, min_size=1, max_size=8, unique=True), st.sampled_from(["", "left_", "image-", "cam0 7 "]))
def test_nanoseconds_in_names_come_back_exactly(stamps: list[int], prefix: str) -> None:
    names = [f"{prefix}{stamp}.png" for stamp in stamps]
    assert folder_stamps(Path("left"), names, IMAGES).tolist() == stamps


@fuzz
@given(st.lists(UNIX_NS, min_size=1, max_size=8, unique=True))
def test_decimal_seconds_in_names_come_back_exactly(stamps: list[int]) -> None:
    names = [f"{stamp // 10**9}.{stamp % 10**9:09d}.png" for stamp in stamps]
    assert folder_stamps(Path("left"), names, IMAGES).tolist() == stamps


@pytest.mark.parametrize(
    ("name", "ns"),
    [
        ("1760000000.png", 1760000000_000000000),
        ("1760000000.123456.png", 1760000000_123456000),
        ("left_1760000000123.png", 1760000000_123000000),
        ("1760000000123456.tiff", 1760000000_123456000),
        ("image-1760000000123456789.jpg", 1760000000_123456789),
        ("frame_000017_1760000000.5_l.png", 1760000000_500000000),
        ("1760000000.5.left.png", 1760000000_500000000),
    ],
)
def test_the_size_of_the_number_tells_its_unit(name: str, ns: int) -> None:
    assert folder_stamps(Path("left"), [name], IMAGES).tolist() == [ns]


CLOCKED = [1760000000_031000064 + 100_000_000 * i + 700 * i * i for i in range(25)]


@pytest.mark.parametrize("name", ["{}_{:09d}.png", "{}_{}.png", "left 1 {}-{:09d}.png", "{}.{}.png", "{}.{:09d}.png"])
@pytest.mark.parametrize("stamps", [CLOCKED, [1000 * (stamp // 1000) for stamp in CLOCKED]], ids=["ns", "us"])
def test_seconds_and_nanoseconds_in_names(name: str, stamps: list[int]) -> None:
    names = [name.format(*divmod(stamp, 10**9)) for stamp in stamps]
    assert folder_stamps(Path("left"), names, IMAGES).tolist() == stamps


def test_seconds_whose_zeros_at_the_end_are_left_out() -> None:
    names = [f"{fixed(stamp).rstrip('0')}.png" for stamp in [*CLOCKED, 1760000003_100000000, 1760000003_20000000]]
    assert folder_stamps(Path("left"), names, IMAGES)[:25].tolist() == CLOCKED


@pytest.mark.parametrize(("name", "unit"), [("{}_{:06d}.png", 10**3), ("{}-{}.png", 10**3), ("{}_{:03d}.png", 10**6)])
def test_seconds_and_micro_or_milliseconds_in_names(name: str, unit: int) -> None:
    names = [name.format(stamp // 10**9, stamp % 10**9 // unit) for stamp in CLOCKED]
    assert folder_stamps(Path("left"), names, IMAGES).tolist() == [stamp // unit * unit for stamp in CLOCKED]


def test_two_decimal_times_are_not_taken_for_nanoseconds_without_zeros() -> None:
    names = ["1760000000.5.png", "1760000000.600000001.png"]
    assert folder_stamps(Path("left"), names, IMAGES).tolist() == [1760000000_500000000, 1760000000_600000001]


def test_a_serial_number_that_looks_like_a_time_is_none() -> None:
    names = [f"1722341234_{fixed(stamp)}.png" for stamp in CLOCKED]
    assert folder_stamps(Path("left"), names, IMAGES).tolist() == CLOCKED


def test_a_counter_that_begins_anew_each_second_is_no_part_of_it() -> None:
    names = [f"{1760000000 + i // 10}_{i % 10:06d}.png" for i in range(30)]
    with pytest.raises(ImageError, match=r"1760000000_000000\.png and 1760000000_000001\.png have the same time"):
        in_time(Path("left"), names, IMAGES)


def test_a_counter_behind_seconds_is_no_part_of_a_second() -> None:
    names = [f"{1760000000 + i}_{i:06d}.png" for i in range(5)]
    assert np.diff(folder_stamps(Path("left"), names, IMAGES)).tolist() == [10**9] * 4


def test_the_unit_is_that_of_the_folder_not_of_the_file() -> None:
    names = [f"{1760000000000 + 100 * i}.png" for i in range(9)]
    with pytest.raises(ImageError, match=r"'1760000000\.png' holds no time in milliseconds"):
        folder_stamps(Path("left"), [*names, "1760000000.png"], IMAGES)


def test_of_two_times_in_every_name_the_finer_one_counts() -> None:
    names = [f"{1500000000 + i}_{1760000000_000000000 + i}.png" for i in range(3)]
    assert np.diff(folder_stamps(Path("left"), names, IMAGES)).tolist() == [1, 1]


@pytest.mark.parametrize("names", [["000001.png", "000002.png"], ["0000000000.png"]])
def test_frame_numbers_are_no_times(names: list[str]) -> None:
    with pytest.raises(ImageError, match=r"left: the names .* are frame numbers, not times; put a timestamps\.txt"):
        folder_stamps(Path("left"), names, IMAGES)


@pytest.mark.parametrize(
    "name",
    ["{:%Y-%m-%dT%H-%M-%S}.{:09d}Z.png", "cam0_{:%Y%m%dT%H%M%S}.{:09d}Z.png", "{:%Y-%m-%d_%H-%M-%S}_{:09d}Z.png"],
)
def test_dates_in_utc_are_times(name: str) -> None:
    clocks = [(datetime.fromtimestamp(stamp // 10**9, timezone.utc), stamp % 10**9) for stamp in CLOCKED]
    assert folder_stamps(Path("left"), [name.format(*clock) for clock in clocks], IMAGES).tolist() == CLOCKED


def test_times_listed_beside_the_folder_are_used_where_names_hold_none(tmp_path: Path) -> None:
    (tmp_path / "timestamps.txt").write_text("\n".join(KITTI))
    assert folder_stamps(tmp_path / "data", NAMES, IMAGES).tolist() == STAMPS
    assert folder_stamps(tmp_path / "data", ["1500000000.png"], IMAGES).tolist() == [1500000000_000000000]
    with pytest.raises(ImageError, match=r"timestamps\.txt holds 3 times; needed are 2, one for each image"):
        folder_stamps(tmp_path / "data", NAMES[:2], IMAGES)


@pytest.mark.parametrize("name", ["20260729130225.png", "2026-07-29T13-02-25.500.png", "cam_2026_07_29_13_02_25.png"])
def test_dates_are_no_times_for_nobody_knows_of_which_zone(name: str) -> None:
    with pytest.raises(
        ImageError, match=r"left: the names .* are dates, of no time zone that is told; put a timestamps"
    ):
        folder_stamps(Path("left"), [name], IMAGES)


def test_a_name_without_any_number_is_named() -> None:
    with pytest.raises(ImageError, match=r"the name 'background\.png' holds no time"):
        folder_stamps(Path("left"), ["1760000000.png", "1760000001.png", "background.png"], IMAGES)
    with pytest.raises(ImageError, match=r"the name 'a\.png' holds no time"):
        folder_stamps(Path("left"), ["a.png", "b.png"], IMAGES)


STAMPS = [1760000000_000000001, 1760000000_100000002, 1760000000_200000003]
NAMES = ["000000.png", "000001.png", "000002.png"]
SECONDS = [fixed(stamp) for stamp in STAMPS]
KITTI = [f"{datetime.fromtimestamp(ns // 10**9, timezone.utc):%Y-%m-%d %H:%M:%S}.{ns % 10**9:09d}" for ns in STAMPS]


@pytest.mark.parametrize(
    "lines",
    [
        [str(stamp) for stamp in STAMPS],
        SECONDS,
        KITTI,
        ["timestamp", *SECONDS],
        ["# seconds", "", *SECONDS, ""],
        [f"{name} {stamp}" for name, stamp in zip(NAMES, SECONDS, strict=True)],
        [f"{name} {stamp}" for name, stamp in zip(NAMES, KITTI, strict=True)],
        ["name,stamp", *(f"{name},{stamp}" for name, stamp in zip(NAMES, SECONDS, strict=True))],
        ["stamp;name", *(f'{stamp};"{name}"' for name, stamp in zip(NAMES, SECONDS, strict=True))],
        [f"{name}\t{stamp}" for name, stamp in reversed(list(zip(NAMES, STAMPS, strict=True)))],
        [f"{Path(name).stem},{stamp}" for name, stamp in zip([*NAMES, "other.png"], [*STAMPS, 7], strict=True)],
        ["#timestamp [ns],filename", *(f"{stamp},left/{name}" for name, stamp in zip(NAMES, STAMPS, strict=True))],
        [f"{name} {stamp} 5.2" for name, stamp in zip(NAMES, SECONDS, strict=True)],
        ["n;file;stamp;gain", *(f"{i};{NAMES[i]};{STAMPS[i]};1.5" for i in (2, 0, 1))],
        [f"{i} {stamp}" for i, stamp in enumerate(SECONDS)],
        ["seq,stamp,exposure", *(f"{i + 7},{stamp},0.01" for i, stamp in enumerate(STAMPS))],
        ["sec nsec", *(f"{stamp // 10**9} {stamp % 10**9}" for stamp in STAMPS)],
        [f"{stamp // 10**9},{stamp % 10**9:09d}" for stamp in STAMPS],
    ],
)
@pytest.mark.parametrize("file", ["timestamps.txt", "timestamps.csv"])
def test_times_listed_in_a_file(tmp_path: Path, file: str, lines: list[str]) -> None:
    (tmp_path / file).write_text("\n".join(lines) + "\n")
    assert folder_stamps(tmp_path, NAMES, IMAGES).tolist() == STAMPS


@pytest.mark.parametrize("line", ["{}.{}", "{} {}", "7 {}.{:09d} 1"])
def test_nanoseconds_in_a_list_may_lack_their_zeros(tmp_path: Path, line: str) -> None:
    (tmp_path / "timestamps.txt").write_text("\n".join(line.format(*divmod(stamp, 10**9)) for stamp in CLOCKED))
    names = [f"{i:06d}.png" for i in range(len(CLOCKED))]
    assert folder_stamps(tmp_path, names, IMAGES).tolist() == CLOCKED


@pytest.mark.parametrize("by_alphabet", [False, True])
def test_a_list_without_names_goes_by_the_counters_in_these(tmp_path: Path, by_alphabet: bool) -> None:
    stamp_of = {f"frame{i}.png": stamp for i, stamp in enumerate(CLOCKED)}
    listed = sorted(stamp_of) if by_alphabet else list(stamp_of)
    (tmp_path / "timestamps.txt").write_text("\n".join(str(stamp_of[name]) for name in listed))
    files, stamps = in_time(tmp_path, sorted(stamp_of), IMAGES)
    assert stamps.tolist() == CLOCKED
    assert [file.name for file in files] == list(stamp_of)


def test_listed_times_go_before_those_in_the_names(tmp_path: Path) -> None:
    (tmp_path / "timestamps.txt").write_text("1760000000\n")
    assert folder_stamps(tmp_path, ["1500000000.png"], IMAGES).tolist() == [1760000000_000000000]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (SECONDS[:2], "holds 2 times; needed are 3, one for each image"),
        ([*SECONDS, SECONDS[0]], "holds 4 times; needed are 3"),
        ([SECONDS[0], "yesterday", SECONDS[2]], "line 2: the time is 'yesterday'; needed is a Unix time in seconds"),
        (["1", "2", "3"], "line 1: the time is '1'; needed is a Unix time or an ISO 8601 time"),
        ([f"{NAMES[0]} {SECONDS[0]}"], r"holds no time for 2 of 3 images, the first of them '000001\.png'"),
        (["", " "], "is empty"),
    ],
)
def test_a_bad_list_of_times_is_refused_with_its_place(tmp_path: Path, lines: list[str], message: str) -> None:
    (tmp_path / "timestamps.txt").write_text("\n".join(lines))
    with pytest.raises(ImageError, match=rf"timestamps\.txt.* {message}"):
        folder_stamps(tmp_path, NAMES, IMAGES)


@fuzz
@given(noise("1760000000", ".5", "\n", "000001.png", ",", " ", "2011-09-26 13:02:25", "1e999", "#"))
def test_any_list_of_times_is_read_or_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "timestamps.txt").write_bytes(content)
    stamps = read_or_refused(lambda: folder_stamps(tmp_path, NAMES, IMAGES), ImageError)
    assert stamps is None or stamps.shape == (3,)


@fuzz
@given(st.lists(st.text(st.characters(exclude_characters="/\0", codec="utf-8"), min_size=1), min_size=1, max_size=4))
def test_any_names_are_read_or_refused(names: list[str]) -> None:
    stamps = read_or_refused(lambda: folder_stamps(Path("left"), names, IMAGES), ImageError)
    assert stamps is None or len(stamps) == len(names)


MAPS = FileKind("map", frozenset({".osm"}), ".osm", MapError)


def test_a_folder_is_refused_in_the_words_of_what_it_should_hold(tmp_path: Path) -> None:
    for folder, words in (
        (tmp_path / "missing", "missing does not exist; needed is a folder of maps"),
        (tmp_path, "is empty; needed are maps"),
    ):
        with pytest.raises(MapError, match=words):
            names_in(folder, MAPS)
    (tmp_path / "1760000000.png").write_bytes(b"")
    with pytest.raises(MapError, match=r"holds 1 files but no map; needed are \.osm files"):
        names_in(tmp_path, MAPS)
    for names, words in (
        (["a.osm"], "needed is a Unix time in the name of each map"),
        (["1.osm", "2.osm"], "one Unix time per map into the folder, or name the maps by their time, in Unix sec"),
        (["1760000000.0.osm", "1760000000.00.osm"], "have the same time, .* needed is one time for each map"),
    ):
        with pytest.raises(MapError, match=words):
            in_time(tmp_path, names, MAPS)


@fuzz
@given(st.permutations([1760000000_000000000 + 7 * i for i in range(6)]))
def test_files_come_in_the_order_of_time(stamps: list[int]) -> None:
    names = [f"{letter}_{stamp}.osm" for letter, stamp in zip("abcdef", stamps, strict=True)]
    files, found = in_time(Path("maps"), names, MAPS)
    assert found.tolist() == sorted(stamps)
    assert [int(file.stem[2:]) for file in files] == sorted(stamps)
