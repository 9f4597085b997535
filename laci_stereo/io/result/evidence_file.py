"""``evidence.npz``: the data of a result's drives, from which it can be estimated again together with other results.

The file holds plain arrays and strings, no pickles. Points are in the level frame of their drive's own ground plane,
which is stored, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from pyproj import CRS
from pyproj.exceptions import CRSError

from laci_stereo.core.cloud import Cameras
from laci_stereo.core.errors import EvidenceError
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.estimation.scanner_turn import TURNS
from laci_stereo.core.frames import Axes, FloatArray
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.messages.slope import Slope
from laci_stereo.core.settings import METHODS
from laci_stereo.core.tracking.background import Background, BackgroundBox
from laci_stereo.core.tracking.box import Box
from laci_stereo.core.tracking.sighting import Flaw, Low, Sighting
from laci_stereo.core.tracking.tracks import Track
from laci_stereo.core.world import World
from laci_stereo.io.file_content import read_bytes
from laci_stereo.io.numpy_file import archived

Arrays: TypeAlias = dict[str, npt.NDArray[Any]]

FORMAT = "laci-evidence/8"
KINDS = ("stereo", "lidar", "detections")
FLAWS: tuple[Flaw | None, ...] = (None, "cut", "far", "thin")

MAX_BYTES = 1 << 28
"""Largest size of all arrays, sufficient for thirty drives with 2000 frames each: a damaged file must not exhaust the
memory."""

LAYOUT: dict[str, tuple[str, tuple[int | str, ...]]] = {
    "name": ("U", ()),
    "crs": ("U", ()),
    "world": ("f", (3,)),  # origin east and north, grid scale
    "axes": ("f", (2, 3)),  # forward, up
    "ground_plane": ("f", (4,)),  # normal, height
    "ground_covariance": ("f", (4, 4)),
    "ground_support": ("f", (5,)),  # fraction of inliers, number and fraction of supporting cells, area, unevenness
    "static_boxes": ("f", ("boxes", 6)),  # centre x and y, length, width, yaw, height
    "static": ("f", (2,)),  # quiet frames, margin
    "station_id": ("i", ()),
    "epoch_ns": ("i", ()),
    "message_stamps_s": ("f", ("messages",)),
    "message_poses": ("f", ("messages", 3)),  # x, y, yaw in the world
    "message_altitudes_m": ("f", ("messages", 1)),  # NaN: not reported
    "vehicle": ("f", (7,)),  # length, width, reference x and y, guessed_m, sigma of the positions (NaN: unknown)
    "slope": ("f", (7,)),  # gradient, covariance xx, xy, yy, pivot; all 0 if unknown
    "turn": ("f", (2,)),  # a scanner's period (0: not needed) and estimated sense of rotation (1, -1, 0: none)
    "window": ("f", ()),  # side of the matching window, within which points share their noise, rad; 0: none
    "cameras": ("f", (2, 3)),  # baseline and optical axis in the level frame; all 0: no stereo camera
    "method": ("U", ()),  # that estimated the drive's own match and clock offset
    "own": ("f", (6,)),  # yaw, x, y and clock offset from this drive alone; a priori sigmas: clock, between images
    "stamps_s": ("f", ("frames", 2)),  # of the points, of their frame
    "begins": ("f", ("frames",)),  # azimuth at which a rotating scanner's scans begin
    "middles": ("f", ("frames", 2)),
    "boxes": ("f", ("frames", 5)),  # centre x and y, length, width, yaw
    "noise": ("f", ("frames", 2)),  # sigma of the points, radial speed (NaN: not measured)
    "borders": ("f", ("frames", 6)),  # outermost points, right and left; (0, 0, 0), below the sensor, if unknown
    "counts": ("i", ("frames", 4)),  # points seen, points kept, flaw, low points kept
    "points": ("f", ("points", 3)),
    "sigmas": ("f", ("points", 2)),  # along and across the line of sight
    "low": ("f", ("lows", 5)),  # x, y, z; along and across the line of sight
    "objections": ("U", ("objections",)),
    "by_chance": ("U", ()),  # empty: it is not
}
"""The arrays of each drive: NumPy kind, and shape; dimensions with the same name have the same length."""

MAY_LACK = ("message_altitudes_m", "vehicle", "noise")
"""Arrays whose last column may hold NaN, for unknown values."""


@dataclass(frozen=True)
class Kept:
    """The data that a result keeps of its drives.

    Attributes
    ----------
    name, kind, frame : str
        Of the sensor; the frame is described in words.
    T_sensor_rectified : ndarray, shape (4, 4), or None
        Only of a stereo camera.
    passages : tuple of Passage
    """

    name: str
    kind: str
    frame: str
    T_sensor_rectified: FloatArray | None
    passages: tuple[Passage, ...]


def write_evidence(path: Path, kept: Kept) -> None:
    """Write a result's evidence; points are rounded to single precision, 0.01 mm at 100 m.

    The file is not compressed, because noise is hardly compressible: the drives of a camera would shrink by a tenth,
    those of a scanner, which are small anyway, by a third.
    """
    arrays: Arrays = {
        "format": np.array(FORMAT),
        "sensor": np.array([kept.name, kept.kind, kept.frame]),
        "drives": np.array(len(kept.passages)),
    }
    if kept.T_sensor_rectified is not None:
        arrays["T_sensor_rectified"] = kept.T_sensor_rectified
    for number, passage in enumerate(kept.passages):
        arrays |= {f"{number}.{name}": array for name, array in _to_arrays(passage).items()}
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def read_evidence(path: Path) -> Kept:
    """Read a result's evidence.

    Raises
    ------
    EvidenceError
        If the file is missing, damaged, of another version, or inconsistent.
    """
    content = read_bytes(path, EvidenceError, f"an evidence file ({FORMAT})", MAX_BYTES)
    arrays = archived(content, str(path), EvidenceError, most=MAX_BYTES)
    form = _text(path, arrays, "format", ())[0]
    if form != FORMAT:
        raise EvidenceError(f"{path}: format is {form[:40]!r}; needed is {FORMAT}: calibrate again with this version")
    name, kind, frame = _text(path, arrays, "sensor", (3,))
    if kind not in KINDS:
        raise EvidenceError(f"{path}: the sensor's kind is {kind[:40]!r}; needed is one of {', '.join(KINDS)}")
    rectified = arrays.get("T_sensor_rectified")
    if rectified is not None:
        rectified = _number(path, "T_sensor_rectified", rectified, "f", (4, 4), {}).astype(np.float64)
    drives = int(_number(path, "drives", arrays.get("drives"), "i", (), {}))
    if not 0 < drives <= len(arrays):
        raise EvidenceError(f"{path}: holds {drives} drives; needed is at least 1, and all of their arrays")
    return Kept(name, kind, frame, rectified, tuple(_passage(path, arrays, number) for number in range(drives)))


def _text(path: Path, arrays: Arrays, name: str, shape: tuple[int, ...]) -> list[str]:
    found = _number(path, name, arrays.get(name), "U", shape, {})
    return [str(text) for text in found.reshape(-1)]


def _number(
    path: Path,
    name: str,
    array: npt.NDArray[Any] | None,
    kind: str,
    shape: tuple[int | str, ...],
    lengths: dict[str, int],
) -> npt.NDArray[Any]:
    """Check an array's kind, shape and finiteness; a named dimension without a length yet gets it from this array."""
    words = {"f": "numbers", "i": "whole numbers", "U": "text"}[kind]
    if array is None:
        raise EvidenceError(f"{path} lacks {name}; needed are {words}")
    wanted = shape
    if array.ndim == len(shape):
        wanted = tuple(
            size if isinstance(size, int) else lengths.setdefault(size, found)
            for size, found in zip(shape, array.shape, strict=True)
        )
    if array.dtype.kind != kind or array.shape != wanted:
        raise EvidenceError(
            f"{path}: {name} is {array.dtype} of shape {array.shape}; needed are {words}, shape {wanted}"
        )
    known = array[..., :-1] if name.split(".")[-1] in MAY_LACK else array
    if kind == "f" and not np.isfinite(known).all():
        raise EvidenceError(f"{path}: {name} holds {np.count_nonzero(~np.isfinite(known))} numbers that are not finite")
    return array


def _to_arrays(passage: Passage) -> Arrays:
    """Return a drive's arrays, as in `LAYOUT`."""
    ground, vehicle, sightings = passage.ground, passage.vehicle, passage.track.sightings
    support = (ground.inlier_share, ground.support_cells, ground.support_share, ground.support_area_m2)
    static = [(*_row(each.box), each.height_m) for each in passage.background.boxes]
    noise = [(each.sigma_m, np.nan if each.radial_mps is None else each.radial_mps) for each in sightings]
    counts = [(each.count, len(each.points), FLAWS.index(each.flaw), len(each.low.points)) for each in sightings]
    sigmas = [np.column_stack([each.sigma_along_m, each.sigma_across_m]) for each in sightings]
    low = [np.column_stack([each.low.points, each.low.sigma_along_m, each.low.sigma_across_m]) for each in sightings]
    priors = passage.clock_sigma_s, passage.apart_sigma_s
    size = (vehicle.length_m, vehicle.width_m, *vehicle.reference, *vehicle.guessed_m, vehicle.position_sigma_m)
    return {
        "name": np.array(passage.name),
        "crs": np.array(passage.world.crs),
        "world": np.array([*passage.world.origin_utm, passage.world.grid_scale]),
        "axes": np.array([passage.axes.forward, passage.axes.up], dtype=np.float64),
        "ground_plane": np.append(ground.normal, ground.height_m),
        "ground_covariance": ground.covariance_sensor,
        "ground_support": np.array([*support, ground.unevenness_m], dtype=np.float64),
        "static_boxes": np.array(static, dtype=np.float64).reshape(-1, 6),
        "static": np.array([passage.background.quiet_frames, passage.background.margin_m], dtype=np.float64),
        "station_id": np.array(passage.station_id, dtype=np.int64),
        "epoch_ns": np.array(vehicle.epoch_ns, dtype=np.int64),
        "message_stamps_s": vehicle.stamps_s,
        "message_poses": np.column_stack([vehicle.xy, vehicle.yaw_rad]),
        "message_altitudes_m": _of_altitudes(vehicle),
        "vehicle": np.array(size),
        "slope": _of_slope(vehicle),
        "turn": np.array([passage.track.turn_s, passage.turn]),
        "window": np.array(passage.track.window_rad),
        "cameras": _of_cameras(passage.track.cameras),
        "method": np.array(passage.method),
        "own": np.array([passage.match.yaw_rad, *passage.match.shift, passage.time_offset_s, *priors]),
        "stamps_s": np.array([(each.stamp_s, each.frame_s) for each in sightings]).reshape(-1, 2),
        "begins": np.array([each.begin_rad for each in sightings]),
        "middles": np.array([each.middle for each in sightings]).reshape(-1, 2),
        "boxes": np.array([_row(each.box) for each in sightings]).reshape(-1, 5),
        "noise": np.array(noise).reshape(-1, 2),
        "borders": np.nan_to_num([each.borders for each in sightings]).reshape(-1, 6),
        "counts": np.array(counts, dtype=np.int64).reshape(-1, 4),
        "points": np.concatenate([np.zeros((0, 3)), *(each.points for each in sightings)]).astype(np.float32),
        "sigmas": np.concatenate([np.zeros((0, 2)), *sigmas]).astype(np.float32),
        "low": np.concatenate([np.zeros((0, 5)), *low]).astype(np.float32),
        "objections": np.array(passage.objections, dtype=np.str_),
        "by_chance": np.array(passage.by_chance),
    }


def _of_altitudes(vehicle: VehicleTrack) -> FloatArray:
    return np.full((len(vehicle.stamps_s), 1), np.nan) if vehicle.altitude_m is None else vehicle.altitude_m[:, None]


def _of_cameras(cameras: Cameras | None) -> FloatArray:
    return np.zeros((2, 3)) if cameras is None else np.stack([cameras.baseline_m, cameras.ahead])


def _cameras(rows: FloatArray) -> Cameras | None:
    return Cameras(rows[0], rows[1]) if rows.any() else None


def _of_slope(vehicle: VehicleTrack) -> FloatArray:
    slope = vehicle.slope
    if slope is None:
        return np.zeros(7)
    return np.concatenate([slope.gradient, slope.covariance[[0, 0, 1], [0, 1, 1]], slope.pivot])


def _slope(row: npt.NDArray[Any]) -> Slope | None:
    if not row.any():
        return None
    return Slope(row[:2], row[[2, 3, 3, 4]].reshape(2, 2), row[5:7])


def _row(box: Box) -> tuple[float, float, float, float, float]:
    return float(box.centre[0]), float(box.centre[1]), box.length_m, box.width_m, box.yaw_rad


def _passage(path: Path, arrays: Arrays, number: int) -> Passage:
    lengths: dict[str, int] = {}
    found = {
        name: _number(path, f"{number}.{name}", arrays.get(f"{number}.{name}"), kind, shape, lengths)
        for name, (kind, shape) in LAYOUT.items()
    }
    _check(path, found)
    *origin, scale = found["world"].tolist()
    forward, up = (tuple(axis) for axis in found["axes"].tolist())
    length_m, width_m, x, y, *guessed, sigma_m = found["vehicle"].tolist()
    yaw, match_x, match_y, offset_s, clock_sigma_s, apart_sigma_s = found["own"].tolist()
    altitude_m = found["message_altitudes_m"][:, 0].astype(np.float64)
    return Passage(
        world=World(str(found["crs"]), (origin[0], origin[1]), scale),
        axes=Axes(forward, up),
        ground=_ground(found),
        background=_background(found),
        track=_track(found),
        vehicle=VehicleTrack(
            stamps_s=found["message_stamps_s"].astype(np.float64),
            epoch_ns=int(found["epoch_ns"]),
            xy=found["message_poses"][:, :2].astype(np.float64),
            yaw_rad=found["message_poses"][:, 2].astype(np.float64),
            length_m=length_m,
            width_m=width_m,
            reference=(x, y),
            position_sigma_m=sigma_m,
            guessed_m=(guessed[0], guessed[1]),
            slope=_slope(found["slope"]),
            altitude_m=None if np.isnan(altitude_m).all() else altitude_m,
        ),
        station_id=int(found["station_id"]),
        match=PlanarMatch(yaw, np.array([match_x, match_y])),
        time_offset_s=offset_s,
        method=METHODS[METHODS.index(str(found["method"]))],
        clock_sigma_s=clock_sigma_s,
        apart_sigma_s=apart_sigma_s,
        turn=float(found["turn"][1]),
        name=str(found["name"]),
        objections=tuple(found["objections"].tolist()),
        by_chance=str(found["by_chance"]),
    )


@np.errstate(over="ignore", invalid="ignore")  # values that overflow to infinity are refused
def _check(path: Path, found: Arrays) -> None:
    """Check that the numbers of a drive are consistent with their meaning.

    Raises
    ------
    EvidenceError
    """
    plane, covariance, counts = found["ground_plane"], found["ground_covariance"], found["counts"]
    holds = {
        "UTM zone": _is_utm(str(found["crs"])),
        "grid scale, between 0.9 and 1.1": 0.9 < found["world"][2] < 1.1,
        "altitudes, of less than 100 km": (np.abs(np.nan_to_num(found["message_altitudes_m"])) < 1e5).all(),
        "axes, at right angles and of length 1": np.allclose(found["axes"] @ found["axes"].T, np.eye(2), atol=1e-6),
        "ground's normal, of length 1": abs(np.linalg.norm(plane[:3]) - 1.0) < 1e-6,
        "ground's height, above 0": plane[3] > 0.0,
        "ground's covariance, symmetric, not negative, and above 0 of normal and height": np.allclose(
            covariance, covariance.T
        )
        and np.trace(covariance[:3, :3]) > 0.0
        and covariance[3, 3] > 0.0
        and np.linalg.eigvalsh(covariance)[0] > -1e-6 * max(float(np.trace(covariance)), 0.0) - 1e-15,
        "vehicle's size, above 0": (found["vehicle"][:2] > 0.0).all() and (found["vehicle"][4:6] >= 0.0).all(),
        "turn, of at least 0 s, by -1, 0 or 1": found["turn"][0] >= 0.0 and found["turn"][1] in TURNS,
        "window, not negative": found["window"] >= 0.0,
        "cameras, a baseline across an optical axis of length 1": not found["cameras"].any()
        or (
            np.linalg.norm(found["cameras"][0]) > 0.0
            and abs(np.linalg.norm(found["cameras"][1]) - 1.0) < 1e-6
            and abs(found["cameras"][0] @ found["cameras"][1]) < 1e-6 * np.linalg.norm(found["cameras"][0])
        ),
        f"method, one of {', '.join(METHODS)}": str(found["method"]) in METHODS,
        "sigmas of times, above 0": (found["own"][4:] > 0.0).all(),
        "messages' stamps, at least 2 and ascending": len(found["message_stamps_s"]) > 1
        and (np.diff(found["message_stamps_s"]) > 0.0).all(),
        "frames' stamps, at least 1 and ascending": len(found["stamps_s"]) > 0
        and (np.diff(found["stamps_s"][:, 0]) >= 0.0).all(),
        "counts of points, whose sum is that of the points": (counts >= 0).all()
        and counts[:, 1].sum() == len(found["points"])
        and counts[:, 3].sum() == len(found["low"]),
        "flaws, from 0 to 3": (counts[:, 2] < len(FLAWS)).all(),
        "sigmas, not negative": (found["sigmas"] >= 0.0).all() and (found["low"][:, 3:] >= 0.0).all(),
    }
    for what, is_so in holds.items():
        if not is_so:
            raise EvidenceError(f"{path}: damaged; needed is: {what}")


def _is_utm(crs: str) -> bool:
    try:
        return CRS.from_user_input(crs).utm_zone is not None
    except CRSError:
        return False


def _ground(found: Arrays) -> GroundPlane:
    inlier_share, cells, share, area_m2, unevenness_m = found["ground_support"].tolist()
    return GroundPlane(
        normal=found["ground_plane"][:3].astype(np.float64),
        height_m=float(found["ground_plane"][3]),
        covariance_sensor=found["ground_covariance"].astype(np.float64),
        inlier_share=inlier_share,
        support_cells=int(cells),
        support_share=share,
        support_area_m2=area_m2,
        unevenness_m=unevenness_m,
    )


def _background(found: Arrays) -> Background:
    quiet, margin_m = found["static"].tolist()
    boxes = tuple(BackgroundBox(_box(row[:5]), float(row[5])) for row in found["static_boxes"].astype(np.float64))
    return Background(boxes, int(quiet), margin_m)


def _box(row: FloatArray) -> Box:
    return Box(row[:2], float(row[2]), float(row[3]), float(row[4]))


def _track(found: Arrays) -> Track:
    ends, low_ends = (np.append(0, np.cumsum(found["counts"][:, column])).tolist() for column in (1, 3))
    points, sigmas, all_low = (found[name].astype(np.float64) for name in ("points", "sigmas", "low"))
    low = all_low[:, :3], all_low[:, 3], all_low[:, 4]
    boxes, middles = (found[name].astype(np.float64) for name in ("boxes", "middles"))
    borders = found["borders"].astype(np.float64).reshape(-1, 2, 3)
    borders[~borders[:, :, :2].any(axis=2)] = np.nan
    turn_s, window_rad = float(found["turn"][0]), float(found["window"])
    cameras = _cameras(found["cameras"].astype(np.float64))
    stamps, noise, counts = (found[name].tolist() for name in ("stamps_s", "noise", "counts"))
    return Track(
        tuple(
            Sighting(
                stamp_s=stamps[i][0],
                frame_s=stamps[i][1],
                points=points[first:end],
                sigma_along_m=sigmas[first:end, 0],
                sigma_across_m=sigmas[first:end, 1],
                count=counts[i][0],
                middle=middles[i],
                box=_box(boxes[i]),
                flaw=FLAWS[counts[i][2]],
                sigma_m=noise[i][0],
                radial_mps=None if np.isnan(noise[i][1]) else noise[i][1],
                turn_s=turn_s,
                begin_rad=float(found["begins"][i]),
                window_rad=window_rad,
                cameras=cameras,
                low=Low(*(column[slice(*lows)] for column in low)),
                borders=borders[i],
            )
            for i, ((first, end), lows) in enumerate(zip(pairwise(ends), pairwise(low_ends), strict=True))
        )
    )
