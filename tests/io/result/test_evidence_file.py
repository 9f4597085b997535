from __future__ import annotations

import io
import pickle
import tracemalloc
import zipfile
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from laci_stereo.core.cloud import Cameras
from laci_stereo.core.errors import EvidenceError, InputError
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.messages.slope import Slope
from laci_stereo.core.tracking.box import Box
from laci_stereo.core.tracking.sighting import NOTHING_LOW, Low
from laci_stereo.core.tracking.tracks import Track
from laci_stereo.io.result.evidence_file import LAYOUT, Kept, read_evidence, write_evidence
from tests.report.support import calibration

FAST = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


SLOPE = Slope(np.array([0.05, -0.02]), np.array([[1e-4, 2e-5], [2e-5, 3e-4]]), np.array([4.0, -7.0]))


def passage() -> Passage:
    """A drive with every kind of value: points and none, each flaw, a radial speed and none; the scanner turns."""
    made = calibration().passages[0]
    rng = np.random.default_rng(0)
    sightings = list(made.track.sightings)
    for i, flaw in enumerate(("cut", "far", "thin", None)):
        count = 50 * i
        sightings[i] = replace(
            sightings[i],
            points=rng.uniform(-100.0, 100.0, (count, 3)),
            sigma_along_m=rng.uniform(0.01, 0.5, count),
            sigma_across_m=rng.uniform(0.001, 0.02, count),
            count=3 * count,
            flaw=flaw,  # type: ignore[arg-type]
            sigma_m=0.02 * i,
            radial_mps=-3.5 if i == 2 else None,
            borders=rng.uniform(-100.0, 100.0, (2, 3)) if i else np.array([[np.nan] * 3, [9.0, 2.0, 0.5]]),
            low=Low(rng.uniform(-1.0, 1.0, (10 * i, 3)), rng.uniform(0.1, 0.5, 10 * i), rng.uniform(0.0, 0.1, 10 * i)),
        )
    vehicle = replace(
        made.vehicle,
        reference=(2.2, -0.1),
        position_sigma_m=0.03,
        guessed_m=(0.4, 0.0),
        slope=SLOPE,
        altitude_m=np.where(made.vehicle.stamps_s < 1.0, np.nan, 560.0 + made.vehicle.stamps_s),
    )
    cameras = Cameras(np.array([0.0, -0.5, 0.0]), np.array([0.96, 0.0, -0.28]))
    track = Track(
        tuple(replace(each, turn_s=0.1, begin_rad=2.5, window_rad=0.011, cameras=cameras) for each in sightings)
    )
    made = replace(made, time_offset_s=-0.012, apart_sigma_s=0.002, turn=-1.0, name="monday")
    made = replace(made, objections=("something rides along", "a frame repeats"), by_chance="may be by chance")
    return replace(made, track=track, vehicle=vehicle)


def kept() -> Kept:
    other = replace(passage(), station_id=43, vehicle=replace(passage().vehicle, position_sigma_m=float("nan")))
    other = replace(other, objections=(), by_chance="")
    return Kept("mast 7", "stereo", "raw left camera", np.eye(4), (passage(), other))


@cache
def content() -> bytes:
    # Written by hand to a path once; what follows only takes bytes of it.
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "evidence.npz"
        write_evidence(path, kept())
        return path.read_bytes()


def arrays() -> dict[str, npt.NDArray[Any]]:
    with np.load(io.BytesIO(content()), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def refused(path: Path, *words: str) -> None:
    with pytest.raises(EvidenceError) as caught:
        read_evidence(path)
    line = str(caught.value)
    assert "\n" not in line
    for word in (str(path), *words):
        assert word in line


def same(one: object, other: object, within: float) -> None:
    """Compare all that a dataclass holds, so that a new attribute that is not written is noticed."""
    assert type(one) is type(other)
    for field in fields(one):  # type: ignore[arg-type]
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, str) or a is None or field.name == "objections":
            assert a == b, field.name
        elif isinstance(a, tuple) and a and hasattr(a[0], "__dataclass_fields__"):
            assert len(a) == len(b)
            for each, its in zip(a, b, strict=True):
                same(each, its, within)
        elif hasattr(a, "__dataclass_fields__"):
            same(a, b, within)
        else:
            assert np.asarray(a) == pytest.approx(np.asarray(b), abs=within, nan_ok=True), field.name


def test_what_is_written_is_read_to_a_millimetre(tmp_path: Path) -> None:
    path = tmp_path / "evidence.npz"
    write_evidence(path, kept())
    found = read_evidence(path)
    assert (found.name, found.kind, found.frame) == ("mast 7", "stereo", "raw left camera")
    assert found.T_sensor_rectified == pytest.approx(np.eye(4))
    assert len(found.passages) == 2
    for one, other in zip(kept().passages, found.passages, strict=True):
        same(one, other, 1e-4)
        assert one.span_ns == other.span_ns
    write_evidence(path, replace(kept(), T_sensor_rectified=None))
    assert read_evidence(path).T_sensor_rectified is None


def test_the_file_is_small_and_the_same_each_time(tmp_path: Path) -> None:
    points = np.random.default_rng(1).uniform(0.0, 60.0, (200, 3))
    full = [
        replace(one, points=points, sigma_along_m=points[:, 0], sigma_across_m=points[:, 1])
        for one in passage().track.sightings
    ]
    kept_full = replace(kept(), passages=(replace(passage(), track=Track(tuple(full))),))
    write_evidence(tmp_path / "a", kept_full)
    write_evidence(tmp_path / "b", kept_full)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert (tmp_path / "a").stat().st_size < 200 * len(full) * 5 * 4 + 20_000


def test_detections_without_points(tmp_path: Path) -> None:
    box = Box(np.array([1.0, 2.0]), 4.0, 1.8, 0.3)
    bare = [
        replace(
            one,
            points=np.zeros((0, 3)),
            sigma_along_m=np.zeros(0),
            sigma_across_m=np.zeros(0),
            low=NOTHING_LOW,
            box=box,
        )
        for one in passage().track.sightings
    ]
    made = Kept("radar", "detections", "x", None, (replace(passage(), track=Track(tuple(bare))),))
    write_evidence(tmp_path / "evidence.npz", made)
    same(made.passages[0], read_evidence(tmp_path / "evidence.npz").passages[0], 1e-9)


def test_other_versions_are_named(tmp_path: Path) -> None:
    path = tmp_path / "evidence.npz"
    np.savez(path, **{**arrays(), "format": np.array("laci-evidence/2")})
    refused(path, "laci-evidence/2", "needed is laci-evidence/8")


def test_what_is_not_there_is_named(tmp_path: Path) -> None:
    refused(tmp_path / "evidence.npz", "does not exist")
    refused(tmp_path, "is a folder; needed is an evidence file")


def test_no_pickle_is_opened(tmp_path: Path) -> None:
    path = tmp_path / "evidence.npz"
    np.savez(path, **{**arrays(), "0.points": np.array([{"a": 1}], dtype=object)}, allow_pickle=True)
    refused(path, "0.points", "is a pickle")
    path.write_bytes(pickle.dumps({"points": 1}))
    refused(path, "is damaged", "needed is a whole archive of arrays")


def test_what_unpacks_to_more_than_any_drive_is_not_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "evidence.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("format.npy", "w") as member:
        for _ in range(300):
            member.write(bytes(1 << 20))
    refused(path, "unpacks to", "at most")


@pytest.mark.parametrize("name", LAYOUT)
def test_every_array_is_needed_in_its_kind_and_shape(tmp_path: Path, name: str) -> None:
    path, whole = tmp_path / "evidence.npz", arrays()
    key = f"1.{name}"
    np.savez(path, **{other: array for other, array in whole.items() if other != key})
    refused(path, f"lacks {key}")
    for wrong in (whole[key][None], np.array(b"bytes"), whole[key].astype(complex) if LAYOUT[name][0] != "U" else None):
        if wrong is not None:
            np.savez(path, **{**whole, key: wrong})
            refused(path, key, "needed are")
    if LAYOUT[name][1] and name not in ("static_boxes", "objections"):  # any number of which may stand there
        np.savez(path, **{**whole, key: whole[key][:-1]})
        with pytest.raises(EvidenceError):
            read_evidence(path)


@pytest.mark.parametrize(
    ("name", "index", "value", "word"),
    [
        ("points", (0, 0), np.nan, "points holds 1 numbers that are not finite"),
        ("world", 2, 0.0, "grid scale"),
        ("message_altitudes_m", (0, 0), -np.inf, "altitudes"),
        ("axes", (0, 0), 2.0, "axes"),
        ("axes", (0, 0), 1e200, "axes"),
        ("ground_plane", 0, 1e200, "normal"),
        ("ground_covariance", (3, 3), -1e308, "covariance"),
        ("ground_plane", 0, 2.0, "normal"),
        ("ground_plane", 3, -1.0, "height"),
        ("ground_covariance", (0, 1), 1.0, "covariance"),
        ("ground_covariance", (3, 3), -1.0, "covariance"),
        ("ground_covariance", ..., 0.0, "above 0 of normal and height"),
        ("vehicle", 0, 0.0, "size"),
        ("own", 4, 0.0, "sigmas of times"),
        ("own", 5, 0.0, "sigmas of times"),
        ("cameras", (0, 0), 0.3, "baseline across an optical axis"),
        ("cameras", 0, 0.0, "baseline across an optical axis"),
        ("cameras", (1, 2), 2.0, "baseline across an optical axis"),
        ("message_stamps_s", 1, -1e9, "messages' stamps"),
        ("stamps_s", (1, 0), -1e9, "frames' stamps"),
        ("counts", (0, 1), 7, "counts of points"),
        ("counts", (0, 2), 4, "flaws"),
        ("counts", (0, 3), 1, "counts of points"),
        ("low", (0, 4), -1.0, "sigmas"),
        ("sigmas", (0, 0), -1.0, "sigmas"),
    ],
)
def test_values_that_make_no_sense_are_named(tmp_path: Path, name: str, index: Any, value: float, word: str) -> None:
    whole = arrays()
    whole[f"0.{name}"][index] = value
    np.savez(tmp_path / "evidence.npz", **whole)
    refused(tmp_path / "evidence.npz", word)


@pytest.mark.parametrize(
    ("name", "value"),
    [("0.crs", "EPSG:4326"), ("0.crs", "nowhere"), ("0.method", "by eye"), ("drives", -1), ("drives", 3)],
)
def test_texts_and_numbers_of_drives_that_make_no_sense_are_refused(tmp_path: Path, name: str, value: object) -> None:
    np.savez(tmp_path / "evidence.npz", **{**arrays(), name: np.array(value)})
    refused(tmp_path / "evidence.npz")


@pytest.mark.parametrize("old", [b"'<f8'", b"'abc'"])
def test_a_header_that_python_would_warn_of_is_refused_without_warning(tmp_path: Path, old: bytes) -> None:
    path, damaged = tmp_path / "evidence.npz", io.BytesIO()
    np.save(damaged, np.ones(5, dtype=[("abc", "<f8")]))
    assert old in damaged.getvalue()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("0.own.npy", damaged.getvalue().replace(old, b"'\\Lx'"))
    refused(path)


def test_an_array_that_promises_more_than_there_is_takes_no_memory(tmp_path: Path) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (1 << 33,)})
    path = tmp_path / "evidence.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("0.own.npy", header.getvalue())
    tracemalloc.start()
    try:
        refused(path, f"its header promises '({1 << 33},)' values of 8 bytes, and 0 bytes follow")
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


@FAST
@given(st.binary(max_size=2000))
def test_any_bytes_are_refused_in_one_line(tmp_path: Path, junk: bytes) -> None:
    path = tmp_path / "evidence.npz"
    for start in (b"", b"PK\x03\x04", b"\x93NUMPY\x01\x00"):
        path.write_bytes(start + junk)
        refused(path)


@FAST
@given(st.floats(0.0, 1.0, exclude_max=True))
def test_a_truncated_file_is_refused_in_one_line(tmp_path: Path, share: float) -> None:
    path = tmp_path / "evidence.npz"
    path.write_bytes(content()[: int(share * len(content()))])
    refused(path)


@FAST
@given(st.lists(st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=20))
def test_a_damaged_file_is_read_or_refused_in_one_line(tmp_path: Path, damage: list[tuple[float, int]]) -> None:
    path, bad = tmp_path / "evidence.npz", bytearray(content())
    for where, byte in damage:
        bad[int(where * len(bad))] = byte
    path.write_bytes(bytes(bad))
    try:
        read_evidence(path)
    except InputError as error:
        assert "\n" not in str(error)  # noqa: PT017


@FAST
@given(st.sampled_from(sorted(LAYOUT)), st.binary(min_size=8, max_size=300))
def test_an_array_of_any_bytes_is_read_or_refused_in_one_line(tmp_path: Path, name: str, junk: bytes) -> None:
    path = tmp_path / "evidence.npz"
    with zipfile.ZipFile(io.BytesIO(content())) as whole, zipfile.ZipFile(path, "w") as archive:
        for member in whole.namelist():
            data = whole.read(member)
            if member == f"0.{name}.npy":
                data = data[: len(data) // 2] + junk + data[len(data) // 2 + len(junk) :]
            archive.writestr(member, data)
    try:
        read_evidence(path)
    except InputError as error:
        assert "\n" not in str(error)  # noqa: PT017
