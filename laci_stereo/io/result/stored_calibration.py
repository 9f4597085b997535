"""Stored results: the parts of a ``calibration.json`` that other commands use."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from laci_stereo.core.errors import CalibrationFileError, SettingError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.world import World, utm_code
from laci_stereo.io.output import RESULT_FILE
from laci_stereo.io.result.calibration_file import Document, validate
from laci_stereo.io.result.siting import Siting
from laci_stereo.io.text_file import read_text

_FARTHEST_FROM_RIGID = 1e-6
"""Largest error of the products of a rotation's rows; written numbers have more digits."""

_FARTHEST_FROM_SYMMETRIC = 1e-6
"""Largest difference of a covariance's two halves, as a correlation; rounding makes less than 1e-12."""

_SAME = 1e-3
"""Largest difference of two transforms that are the same, in metres: UTM coordinates are written with more digits."""

_NEEDED = f"needed is a {RESULT_FILE} (laci-stereo import makes one of what other tools, or export, wrote)"


@dataclass(frozen=True)
class StoredCalibration(Siting):
    """A result as stored in its file: the pose of its sensor, and more.

    Attributes
    ----------
    path : Path
    covariance : ndarray, shape (6, 6)
        Of (rotation vector, rad; translation, m), applied on the left in the world frame about ``centre_world``. NaN if
        unknown, as in an imported result.
    boxes : ndarray, shape (n, 6)
        The static background, world frame: centre x and y, length, width, yaw, height.
    angles_deg : tuple of float
        Roll, down and yaw, see `ViewingAngles`.
    rectified : bool
        Whether the images were already rectified.
    baseline_m : float or None
        The distance between the cameras that the user stated; None: that of the stereo calibration.
    turn_deg : tuple of float or None
        Rotation of the right camera since its calibration, see `StereoSettings.turn_deg`.
    verdict : str or None
        None where the result claims nothing.
    """

    path: Path
    covariance: FloatArray
    boxes: FloatArray
    angles_deg: tuple[float, float, float]
    rectified: bool
    baseline_m: float | None
    turn_deg: tuple[float, float, float] | None
    verdict: str | None = None

    @property
    def claims(self) -> bool:
        """Whether the result states its own accuracy."""
        return not np.isnan(self.covariance).all()


def read_calibration(result: Path) -> StoredCalibration:
    """Read a stored result: its folder, or its ``calibration.json``.

    Raises
    ------
    CalibrationFileError
        If the file cannot be read, does not conform to the schema, has an invalid transform or covariance, or two that
        contradict each other.
    """
    path = result / RESULT_FILE if result.is_dir() else result
    if not path.exists():
        raise CalibrationFileError(f"{path} does not exist; needed is a result's folder or its {RESULT_FILE}")
    text = read_text(path, CalibrationFileError)
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as problem:
        raise CalibrationFileError(f"{path} is no JSON: {problem}; {_NEEDED}") from problem
    if not isinstance(document, dict) or "schema" not in document:
        raise CalibrationFileError(f"{path} is no result, as it has no 'schema'; {_NEEDED}")
    try:
        validate(document)
    except CalibrationFileError as problem:
        raise CalibrationFileError(f"{path}: {problem}") from problem
    try:
        stored, T_utm_sensor = _parsed(path, document), np.array(document["T_utm_sensor"], dtype=np.float64)
    except OverflowError as problem:  # integers in JSON may exceed any float
        raise CalibrationFileError(f"{path} holds a number out of range: {problem}; needed are floats") from problem
    _check(stored)
    off = float(np.abs(stored.T_utm_sensor - T_utm_sensor).max())
    if not off < _SAME:
        raise CalibrationFileError(
            f"{path}: T_utm_sensor and T_world_sensor contradict each other by up to {off:.3g}: one of them, or the "
            "world frame, was edited; needed is the file as it was written"
        )
    return stored


def _parsed(path: Path, document: Document) -> StoredCalibration:
    sensor, world, angles = document["sensor"], document["world"], document["euler_deg"]
    stereo = document["config"].get("stereo")
    images: Document = stereo if isinstance(stereo, dict) else {}
    baseline_m = images.get("baseline_m")
    east, north = world["origin_utm"]
    return StoredCalibration(
        path=path,
        name=sensor["name"],
        kind=sensor["kind"],
        frame=sensor["frame"],
        world=World(world["crs"], (float(east), float(north)), float(world["grid_scale"])),
        T_world_sensor=np.array(document["T_world_sensor"], dtype=np.float64),
        covariance=_covariance(document["covariance"]),
        centre_world=np.array(document["covariance_centre_world"], dtype=np.float64),
        boxes=np.array(document["background_boxes"], dtype=np.float64).reshape(-1, 6),
        angles_deg=(angles["roll"], angles["down"], angles["yaw"]),
        rectified=images.get("rectified") is True,
        baseline_m=float(baseline_m) if isinstance(baseline_m, int | float) else None,
        turn_deg=_turn_deg(images.get("turn_deg")),
        verdict=None if document["quality"] is None else document["quality"]["verdict"],
    )


def _turn_deg(value: object) -> tuple[float, float, float] | None:
    match value:
        case [int() | float() as x, int() | float() as y, int() | float() as z]:
            return float(x), float(y), float(z)
    return None


def _covariance(rows: list[list[float]] | None) -> FloatArray:
    return np.full((6, 6), np.nan) if rows is None else np.array(rows, dtype=np.float64)


@np.errstate(over="ignore", invalid="ignore")  # values that overflow to infinity are refused
def _check(stored: StoredCalibration) -> None:
    """Raise if numbers of the right shape are invalid."""
    try:
        utm_code(stored.world.crs)
    except SettingError as problem:
        raise CalibrationFileError(f"{stored.path}: {problem}") from problem
    grid = (*stored.world.origin_utm, stored.world.grid_scale)
    if not all(np.isfinite(each).all() for each in (stored.T_world_sensor, stored.centre_world, stored.boxes, grid)):
        raise CalibrationFileError(f"{stored.path} holds a number that is not finite; needed are finite ones")
    rotation = stored.T_world_sensor[:3, :3]
    off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if not off < _FARTHEST_FROM_RIGID or np.linalg.det(rotation) < 0:
        raise CalibrationFileError(
            f"{stored.path}: T_world_sensor is no rigid transform, its axes are off by {off:.2g}; needed is a rotation"
        )
    if not stored.claims:
        return
    half = stored.covariance / 2
    least = float(np.linalg.eigvalsh(half + half.T).min()) if np.isfinite(half).all() else math.nan
    if not least > -1e-12 * max(float(np.trace(stored.covariance)), 1e-12):
        raise CalibrationFileError(
            f"{stored.path}: covariance has the eigenvalue {least:.2g}; needed are none below zero"
        )
    variances = np.diag(stored.covariance)
    if not (variances > 0.0).all():
        raise CalibrationFileError(
            f"{stored.path}: covariance has the variance {variances.min():.2g}, as if the result were exact; needed "
            "are six above zero, or null instead of a covariance that nobody knows"
        )
    apart = np.abs(stored.covariance - stored.covariance.T) / np.sqrt(np.outer(variances, variances))
    if not apart.max() < _FARTHEST_FROM_SYMMETRIC:
        row, column = np.unravel_index(apart.argmax(), apart.shape)
        upper, lower = stored.covariance[row, column], stored.covariance[column, row]
        raise CalibrationFileError(
            f"{stored.path}: covariance is not symmetric, it has {upper:.3g} in row {row + 1}, column "
            f"{column + 1} and {lower:.3g} the other way; needed is the same in both"
        )
