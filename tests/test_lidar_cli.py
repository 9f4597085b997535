"""The installed ``laci-lidar`` from outside: what it refuses and how, what it leaves behind, whether it is right."""

from __future__ import annotations

import os
import pickle
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import CRS
from rosbags.rosbag2 import StoragePlugin, Writer

from laci_stereo.core.frames import FloatArray, invert, transform
from tests.cli_support import Ran, document_in, link_recording, refused, rewrite, run_installed
from tests.cli_support import run as start
from tests.detections import cam_rows
from tests.lidar.support import (
    CLOUD,
    Array,
    scene,
    write_bag1,
    write_bag2,
    write_bin,
    write_folder,
    write_las,
    write_npy,
    write_pcd,
    write_ply,
)
from tests.simulated import Scene, lidar
from tests.simulated import scene as crossing

COMMAND = Path(sys.executable).with_name("laci-lidar")
NOT_CALIBRATED, UNUSABLE = 1, 2

posix = pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX shell")


def run(arguments: Sequence[str | Path], folder: Path, within: Sequence[str] = (), modules: Path | None = None) -> Ran:
    """Run the command in a folder, perhaps by another command, or with modules that hide the installed."""
    told = [*map(str, arguments)]
    if not within and modules is None:
        return start(told, folder, COMMAND)
    return run_installed(told, folder, within, COMMAND, {} if modules is None else {"PYTHONPATH": str(modules)})


@dataclass(frozen=True)
class Site:
    """A folder as a user has it: scans and a log of messages."""

    root: Path

    @property
    def scans(self) -> Path:
        return self.root / "scans"

    @property
    def cam(self) -> Path:
        return self.root / "cam.csv"

    @property
    def out(self) -> Path:
        return self.root / "result"

    def files(self) -> list[Path]:
        return sorted(self.scans.iterdir())

    def run(self, *options: str | Path, scans: Path | None = None, **how: Any) -> Ran:
        return run(["calibrate", scans or self.scans, self.cam, "--out", self.out, *options], self.root, **how)

    def refused(self, code: int, *words: str, options: Sequence[str] = (), **how: Any) -> str:
        start = partial(self.run, "--quiet", *options, **how)
        return refused(start, self.root, code, *words, program=COMMAND.name)


# ------------------------------------------------------------------------------------- a recording with its truth


@pytest.fixture(scope="session")
def made() -> Scene:
    return crossing(sensor=lidar(layers=48, columns=160))


@pytest.fixture(scope="session")
def columns(made: Scene) -> list[dict[str, Array]]:
    """What a scanner's driver writes of each scan."""
    scans = []
    for cloud in made.recording:
        xyz = cloud.points.astype(np.float32)
        scans.append(dict(zip("xyz", xyz.T, strict=True)) | {"intensity": np.ones(len(xyz), np.float32)})
    return scans


@pytest.fixture(scope="session")
def written(made: Scene, columns: list[dict[str, Array]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording as files; not to be written to."""
    folder = tmp_path_factory.mktemp("lidar")
    write_folder(folder / "scans", columns, stamps_ns=made.recording.stamps_ns)
    cam_rows(made.messages).write(folder / "cam.csv")
    return folder


@pytest.fixture
def site(written: Path, tmp_path: Path) -> Site:
    """The recording, to be damaged at will."""
    link_recording(written, tmp_path)
    return Site(tmp_path)


def errors(made: Scene, T_utm_sensor: FloatArray) -> tuple[float, float]:
    """Return by how much the vehicle's track is off, root mean square in metres, and the turn in degrees."""
    T_true = made.recording.T_world_sensor
    xy, _ = made.vehicle.drive.at(made.recording.times_s)
    seen = transform(invert(T_true), np.column_stack([xy, np.zeros(len(xy))]))
    off = transform(T_utm_sensor, seen)[:, :2] - made.place.to_utm(xy)
    turn = T_utm_sensor[:3, :3] @ T_true[:3, :3].T
    return float(np.sqrt((off**2).sum(axis=1).mean())), float(np.degrees(np.arccos(min(1.0, (np.trace(turn) - 1) / 2))))


ASSUMED = (
    "note: the messages report no accuracy of their positions: taken as 0.02 m, that of a receiver with carrier-phase "
    "corrections; with another the result is as far off as its positions: give --cam-sigma"
)


# The joint estimate within what is required of a LiDAR; the paper's is biased by part of a vehicle's width.
@pytest.mark.parametrize(
    ("method", "most_m", "most_deg"), [(None, 0.03, 0.08), pytest.param("paper", 0.9, 1.5, marks=pytest.mark.slow)]
)
def test_files_in_and_the_true_transform_out(
    site: Site, made: Scene, method: str | None, most_m: float, most_deg: float
) -> None:
    ran = site.run(*([] if method is None else ["--method", method]), "--name", "mast 3")
    assert ran.code == 0, ran
    *found_so, of_the_scanner = ran.err.splitlines()
    assert "--sweep tells it" in of_the_scanner
    assert [note[:50] for note in found_so] == (
        ["note: by the drive, the scanner measures a scan's ", ASSUMED[:50]] if method is None else []
    )
    assert {"calibration.json", "topdown.png"} <= {path.name for path in site.out.iterdir()}
    found = document_in(site.out)
    assert found["method"] == (method or "joint")
    assert found["sensor"] == {"name": "mast 3", "kind": "lidar", "frame": "as in the scans"}
    assert found["inputs"][str(site.scans)] == len(made.recording)
    assert found["station_id"] == 42
    assert found["height_m"] == pytest.approx(6.0, abs=0.02)
    off_m, turned_deg = errors(made, np.array(found["T_utm_sensor"]))
    assert off_m < most_m
    assert turned_deg < most_deg
    assert off_m < 3 * found["quality"]["track_xy_sigma_m"]
    assert "60 scans, " in ran.out
    assert f"{'Height':<11}{found['height_m']:.2f} m above the ground" in ran.out


@pytest.mark.slow
def test_sweep_that_contradicts_the_points_own_times_is_refused(
    site: Site, made: Scene, columns: list[dict[str, Array]]
) -> None:
    for path, scan in zip(site.files(), columns, strict=True):
        path.unlink()
        write_pcd(path, scan | {"time": np.linspace(0.0, 0.1, len(scan["x"]), dtype=np.float32)})
    words = ("scans: the points have times of their own, and --sweep tells others", "needed is no --sweep")
    site.refused(UNUSABLE, *words, options=("--sweep", "start,cw,10"))
    ran = site.run("--sweep", "none")
    assert ran.code == 0, ran
    assert errors(made, np.array(document_in(site.out)["T_utm_sensor"]))[0] < 0.03


# ------------------------------------------------------------------------------------- scans that are none

Damage = Callable[[Path, Mapping[str, Array]], Any]


def is_empty(path: Path, _columns: Mapping[str, Array]) -> None:
    path.write_bytes(b"")


def is_truncated(path: Path, columns: Mapping[str, Array]) -> None:
    path.write_bytes(write_pcd(path, columns).read_bytes()[:5000])


def is_nan(path: Path, columns: Mapping[str, Array]) -> None:
    write_pcd(path, {name: np.full_like(column, np.nan) for name, column in columns.items()})


def is_in_millimetres(path: Path, columns: Mapping[str, Array]) -> None:
    write_pcd(path, {axis: 1000 * columns[axis] for axis in "xyz"})


def is_ply(path: Path, columns: Mapping[str, Array]) -> None:
    write_ply(path.with_suffix(".ply"), columns).rename(path)


def promises(points: int, encoding: str) -> Damage:
    def damage(path: Path, _columns: Mapping[str, Array]) -> None:
        header = f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {points}\nHEIGHT 1\nPOINTS {points}\n"
        path.write_bytes(f"{header}DATA {encoding}\n".encode() + bytes(400))

    return damage


SCANS: dict[str, tuple[Damage, tuple[str, ...]]] = {
    "empty": (is_empty, ("is empty (0 bytes)", "needed is a scan")),
    "truncated": (is_truncated, ("is cut off", "its header promises")),
    "NaN": (is_nan, ("none of its", "points is finite", "needed are numbers in metres")),
    "mm": (is_in_millimetres, ("the median distance of its points is", "at most 1000 m", "are these millimetres")),
    "PLY": (is_ply, ("is a PLY file by its content", "needed is PCD as its name says")),
    "endless ascii": (promises(10**12, "ascii"), ("header promises 1000000000000 points", "400 bytes of text follow")),
    "endless": (promises(10**12, "binary"), ("header promises 1000000000000 points", "400 bytes follow")),
    "endless packed": (promises(10**12, "binary_compressed"), ("header promises 1000000000000 points",)),
}


@pytest.mark.parametrize("name", SCANS)
def test_scans_that_are_none_are_refused(site: Site, columns: list[dict[str, Array]], name: str) -> None:
    damage, words = SCANS[name]
    for path in site.files():
        path.unlink()
        damage(path, columns[0])
    first = str(site.files()[0])
    site.refused(
        UNUSABLE, "of what was read so far, ", "scans are unusable", "needed are at least 80% usable", first, *words
    )


@posix
@pytest.mark.parametrize(
    "encoding",
    [*(pytest.param(encoding, marks=pytest.mark.slow) for encoding in ("ascii", "binary_compressed")), "binary"],
)
def test_a_header_takes_no_memory_by_what_it_promises(site: Site, encoding: str) -> None:
    for path in site.files():
        path.unlink()
        promises(10**12, encoding)(path, {})
    # 4 GiB of addresses: enough for the libraries, and nothing beside 12 TB.
    limited = ["sh", "-c", 'ulimit -v 4194304; OMP_NUM_THREADS=1 exec "$0" "$@"']
    site.refused(UNUSABLE, "header promises 1000000000000 points", within=limited)


@pytest.mark.slow
def test_single_bad_scans_are_left_out_counted_and_named(site: Site, made: Scene) -> None:
    # The frames in which the survey is not taken and the vehicle is in full view.
    damaged = [site.files()[i] for i in (20, 30, 41)]
    for path, damage in zip(damaged, (is_empty, is_truncated, is_nan), strict=True):
        path.unlink()
        damage(path, {axis: np.ones(3000, np.float32) for axis in "xyz"})
    ran = site.run()
    assert ran.code == 0, ran
    assert "3 unreadable" in ran.out
    notes = ran.err.splitlines()
    found_so, assumed, of_the_scanner, *left_out = notes
    assert assumed == ASSUMED
    assert "by the drive, the scanner measures a scan's points all at once" in found_so
    assert "--sweep" in of_the_scanner
    assert len(left_out) == 3
    assert all(any(note.startswith(f"note: {path}") for note in left_out) for path in damaged)
    found = document_in(site.out)
    assert [f"note: {note}" for note in found["notes"]] == notes
    assert errors(made, np.array(found["T_utm_sensor"]))[0] < 0.03


class Trap:
    """What a pickle does when it is loaded."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return os.mkdir, (str(self.path),)


def test_a_pickle_is_never_loaded(site: Site) -> None:
    trap, loaded = Trap(site.root / "loaded"), site.root / "loaded"
    for path in site.files():
        path.unlink()
        np.save(path.with_suffix(".npy"), np.array([trap, None], dtype=object), allow_pickle=True)
    np.load(site.files()[0], allow_pickle=True)
    assert loaded.is_dir()
    loaded.rmdir()
    site.refused(UNUSABLE, "is a pickle", "which is never loaded", "needed is an array of numbers")
    for path in site.files():
        path.write_bytes(pickle.dumps(trap))
    site.refused(UNUSABLE, "is no npy file")
    assert not loaded.exists()


def test_points_on_a_map_are_world_coordinates_already(site: Site, columns: list[dict[str, Array]]) -> None:
    for path, scan in zip(site.files(), columns, strict=True):
        path.unlink()
        few = {axis: scan[axis][:50] for axis in "xyz"} | {"intensity": np.ones(50), "t": np.zeros(50)}
        write_las(path.with_suffix(".las"), few, CRS.from_epsg(32632))
    words = ("UTM zone 32N", "these are world coordinates already", "needed are points in the sensor's own frame")
    site.refused(UNUSABLE, *words)


@pytest.mark.slow
def test_folders_that_hold_no_recording(site: Site, tmp_path: Path) -> None:
    site.refused(UNUSABLE, "missing does not exist", "needed is a folder of scans", scans=tmp_path / "missing")
    site.refused(UNUSABLE, "is a single scan", "needed is the folder", scans=site.files()[0])
    (tmp_path / "empty").mkdir()
    site.refused(UNUSABLE, "is empty", "needed are scans", scans=tmp_path / "empty")
    write_npy(site.scans / "1800000000.npy", scene())
    site.refused(UNUSABLE, "holds 60 PCD and 1 npy files", "needed are scans of one format")
    numbered = tmp_path / "numbered"
    numbered.mkdir()
    for i in range(3):
        write_bin(numbered / f"{i:06d}.bin", scene(i))
    site.refused(UNUSABLE, "'000000.bin'", "frame numbers", "one Unix time per scan", scans=numbered)


# ------------------------------------------------------------------------------------- bags


@pytest.mark.slow
def test_bags_without_the_point_clouds_that_are_meant(site: Site) -> None:
    bag = write_bag1(site.root / "a.bag", {"/left": [scene(0)], "/right": [scene(1)]})
    site.refused(UNUSABLE, "2 topics with point clouds", "--topic with one of /left, /right", scans=bag)
    asked = ["--topic", "/middle"]
    has = "it has /chatter (std_msgs/msg/String), /left (sensor_msgs/msg/PointCloud2), /right"
    site.refused(UNUSABLE, "has no topic '/middle'", has, scans=bag, options=asked)
    site.refused(UNUSABLE, "is of type std_msgs/msg/String", scans=bag, options=["--topic", "/chatter"])
    none = write_bag1(site.root / "none.bag", {})
    site.refused(UNUSABLE, "no topic of type sensor_msgs/PointCloud2", "it has /chatter", scans=none)
    site.refused(UNUSABLE, "is no bag, and has no topic '/left'", options=["--topic", "/left"])


def test_a_definition_that_nobody_knows(site: Site) -> None:
    bag = site.root / "a"
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/points", CLOUD, msgdef="float32[] values\n", rihs01="RIHS01_0")
        writer.write(connection, 1_700_000_000 * 10**9, bytes(16))
    site.refused(UNUSABLE, "/points has a definition of", "needed is that of sensor_msgs/PointCloud2", scans=bag)


@pytest.mark.slow
def test_of_a_bag_that_is_cut_off_the_rest_is_calibrated(
    site: Site, made: Scene, columns: list[dict[str, Array]]
) -> None:
    bag = write_bag2(site.root / "a", {"/points": columns}, "mcap", stamps_ns=made.recording.stamps_ns)
    content = (bag / "a.mcap").read_bytes()
    (bag / "a.mcap").write_bytes(content[: len(content) * 3 // 4])
    ran = site.run(scans=bag)
    assert ran.code == 0, ran
    found = document_in(site.out)
    used = found["inputs"][str(bag)]
    assert 35 < used <= 45
    assert f"the {used} whole messages of /points are used, {60 - used} are lost" in ran.err
    assert errors(made, np.array(found["T_utm_sensor"]))[0] < 3 * found["quality"]["track_xy_sigma_m"]


@pytest.mark.parametrize(
    ("module", "extra"), [("laspy", "las"), pytest.param("rosbags", "bag", marks=pytest.mark.slow)]
)
def test_an_extra_that_is_not_installed_is_named(site: Site, made: Scene, module: str, extra: str) -> None:
    hidden = site.root / "modules"
    hidden.mkdir()
    (hidden / f"{module}.py").write_text(f"raise ModuleNotFoundError(name={module!r})")
    shutil.rmtree(site.scans)
    if extra == "bag":
        write_bag1(site.scans, {"/points": [scene()]})
    else:
        write_folder(site.scans, [scene(seed) for seed in range(60)], "laz", made.recording.stamps_ns)
    words = (f"needs the extra '{extra}'", f"{module} is not installed", f"pip install 'laci-stereo[{extra}]'")
    site.refused(UNUSABLE, *words, modules=hidden)


# ------------------------------------------------------------------------------------- arguments, messages, results


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--axes", "sideways"), ("the axes are 'sideways'", "needed is such as 'x forward, z up'")),
        (("--sweep", "start,cw,10,500"), ("a sweep starts at 500 deg", "needed is -360 to 360")),
        (("--sweep", "start,left,10"), ("--sweep is 'start,left,10'", "needed is start|middle|end,ccw|cw,HZ")),
        (("--sweep", "no"), ("--sweep is 'no'", "or none")),
        (("--sweep", "start,cw,0"), ("rate of sweeps is 0 Hz", "needed is 0.5 to 200")),
        (("--range-sigma", "0"), ("range_sigma_m is 0 m", "needed is more than 0")),
        (("--angle-sigma", "90"), ("angle_sigma_rad is 1.57", "at most 0.1 rad")),
        (("--background", "50..70"), ("background scans are 50..70", "first <= last within 0..59")),
        (("--background", "nowhere"), ("--background is 'nowhere'", "START..END")),
        (("--station", "7"), ("station 7 is not in the log", "needed is one of 42")),
        (("--method", "guess"), ("--method", "'guess'", "see laci-lidar calibrate --help")),
        (("--stereo", "a.yaml"), ("No such option", "--stereo", "see laci-lidar calibrate --help")),
        (("surplus",), ("surplus", "see laci-lidar calibrate --help")),
    ],
)
def test_arguments_that_make_no_sense_are_refused(site: Site, options: tuple[str, ...], words: tuple[str, ...]) -> None:
    site.refused(UNUSABLE, *words, options=options)


def test_missing_arguments_are_named(tmp_path: Path) -> None:
    ran = run(["calibrate", "scans"], tmp_path)
    assert (ran.code, ran.out) == (UNUSABLE, "")
    assert ran.err.splitlines() == ["laci-lidar: Missing argument 'CAM'; see laci-lidar calibrate --help"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("by_s", "guess"), [(1000, ""), (-7200, "time zone of 2 h"), (18, "GPS time is 18 s ahead")])
def test_messages_of_another_time_are_refused(site: Site, made: Scene, by_s: int, guess: str) -> None:
    rows = cam_rows(made.messages)
    rows.column("timestamp", [f"{float(row[0]) + by_s:.3f}" for row in rows.rows])
    site.cam.unlink()
    rows.write(site.cam)
    line = site.refused(UNUSABLE, str(site.cam), "do not overlap", "2023-11-14T22:13:20.123Z", "needed", guess)
    assert ("likely" in line) == bool(guess)


def test_a_vehicle_that_stands_still_is_not_calibrated(site: Site, made: Scene) -> None:
    rows = cam_rows(made.messages)
    for name in ("latitude", "longitude", "heading"):
        place = rows.header.index(name)
        rows.column(name, [rows.rows[20][place]] * len(rows.rows))
    rows.column("speed", ["0.0"] * len(rows.rows))
    site.cam.unlink()
    rows.write(site.cam)
    site.refused(NOT_CALIBRATED, "not calibrated", "stands still", "needed are")


def test_an_existing_result_stays_unless_it_may_be_replaced(site: Site) -> None:
    site.out.mkdir()
    (site.out / "calibration.json").write_text("{}")
    site.refused(UNUSABLE, "result: holds a result already", "--overwrite")
    rewrite(site.cam, b"")
    site.refused(UNUSABLE, "cam.csv is empty", options=["--overwrite"])
