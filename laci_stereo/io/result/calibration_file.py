"""``calibration.json``: the native result, validated against the schema in this package."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from typing import Any, TypeAlias

from jsonschema import Draft202012Validator

from laci_stereo.core.errors import CalibrationFileError
from laci_stereo.core.frames import FloatArray, planar, rotate_xy
from laci_stereo.core.messages.slope import Slope
from laci_stereo.core.result import Calibration
from laci_stereo.io.result.siting import Siting
from laci_stereo.io.text_file import shortened

Document: TypeAlias = dict[str, Any]
"""A JSON object, as the standard library reads and writes it."""

SCHEMA = "calibration.schema.json"


@dataclass(frozen=True)
class Provenance:
    """The origin of a result, as far as the core does not know it.

    Attributes
    ----------
    name, kind, frame : str
        Of the sensor; the frame is described in words.
    inputs : mapping of str to str or int
        Files with their SHA-256, folders with the number of items used.
    config : mapping of str to object
        Every effective setting.
    notes : tuple of str
        How the inputs were interpreted, and which parts of them were left out.
    T_sensor_rectified : ndarray, shape (4, 4), or None
        Only of a stereo camera.
    """

    name: str
    kind: str
    frame: str
    inputs: Mapping[str, str | int]
    config: Mapping[str, object]
    notes: tuple[str, ...] = ()
    T_sensor_rectified: FloatArray | None = None


@cache
def schema() -> Document:
    """Return the JSON Schema (draft 2020-12) of ``calibration.json``."""
    text = files("laci_stereo.io.result").joinpath(SCHEMA).read_text(encoding="utf-8")
    read: Document = json.loads(text)
    return read


def validate(document: object) -> None:
    """Validate a document against the schema.

    Raises
    ------
    CalibrationFileError
        With the first path that does not conform.
    """
    problems = sorted(Draft202012Validator(schema()).iter_errors(document), key=lambda problem: problem.json_path)
    if problems:
        raise CalibrationFileError(f"calibration.json: {problems[0].json_path}: {shortened(problems[0].message)}")


def to_document(calibration: Calibration, provenance: Provenance, lane_check: Document | None = None) -> Document:
    """Return a result as JSON; ``lane_check`` is its comparison with the map's lines, if that was requested."""
    quality, angles, drive = calibration.quality, calibration.viewing_angles, calibration.drive
    siting = Siting(
        provenance.name,
        provenance.kind,
        provenance.frame,
        calibration.world,
        calibration.T_world_sensor,
        calibration.centre_world,
    )
    document: Document = {
        **beginning(siting, drive.method),
        "T_enu_sensor": None if calibration.T_enu_sensor is None else calibration.T_enu_sensor.tolist(),
        "slope": _slope(calibration.slope),
        "height_m": calibration.height_m,
        "euler_deg": {"yaw": angles.yaw_deg, "down": angles.down_deg, "roll": angles.roll_deg},
        "time_offset_s": drive.time_offset_s,
        "time_sigma_s": calibration.time_sigma_s,
        "station_id": drive.station_id,
        "vehicle": {"length_m": drive.vehicle.length_m, "width_m": drive.vehicle.width_m},
        "covariance": calibration.covariance.tolist(),
        "covariance_centre_world": calibration.centre_world.tolist(),
        "quality": {
            "verdict": quality.verdict,
            "reasons": list(quality.reasons),
            "track_xy_sigma_m": quality.track_xy_sigma_m,
            "weakest_sigma_m": quality.weakest_sigma_m,
            "weakest_yaw_deg": quality.weakest_yaw_deg,
            "advice": quality.advice,
            "yaw_sigma_deg": quality.yaw_sigma_deg,
            "tilt_sigma_deg": quality.tilt_sigma_deg,
            "height_sigma_m": quality.height_sigma_m,
            "residual_rms_m": quality.residual_rms_m,
            "frames_used": quality.frames_used,
            "frames_seen": quality.frames_seen,
            "left_out": dict(quality.left_out),
        },
        "paper": _paper(calibration),
        "background_boxes": boxes_in_world(calibration),
        "lane_check": lane_check,
        "inputs": dict(provenance.inputs),
        "notes": list(provenance.notes),
        "config": dict(provenance.config),
    }
    if provenance.T_sensor_rectified is not None:
        document["T_world_rectified"] = (calibration.T_world_sensor @ provenance.T_sensor_rectified).tolist()
    validate(document)
    return document


def beginning(siting: Siting, method: str) -> Document:
    """Return the first members of a result's document: by what it was made, and the pose of its sensor."""
    return {
        "schema": "laci-calibration/1",
        "version": version("laci-stereo"),
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "method": method,
        "sensor": {"name": siting.name, "kind": siting.kind, "frame": siting.frame},
        "world": {
            "crs": siting.world.crs,
            "origin_utm": list(siting.world.origin_utm),
            "grid_scale": siting.world.grid_scale,
        },
        "T_world_sensor": siting.T_world_sensor.tolist(),
        "T_utm_sensor": siting.T_utm_sensor.tolist(),
    }


def _slope(slope: Slope | None) -> Document | None:
    if slope is None:
        return None
    return {
        "gradient": slope.gradient.tolist(),
        "covariance": slope.covariance.tolist(),
        "pivot_world": slope.pivot.tolist(),
    }


def _paper(calibration: Calibration) -> Document | None:
    """Return the result of the paper's method, and its difference from the result."""
    differs = calibration.paper_differs
    if calibration.paper is None or differs is None:
        return None
    T_world_level = planar(calibration.paper.yaw_rad, calibration.paper.shift)
    return {
        "T_world_sensor": (T_world_level @ calibration.T_level_sensor).tolist(),
        "objects_differ_m": differs[0],
        "angle_differs_deg": differs[1],
    }


def boxes_in_world(calibration: Calibration) -> list[list[float]]:
    """Return each background box as centre x, centre y, length, width, yaw, height; metres and radians, world frame."""
    match = calibration.drive.match
    return [
        [
            *map(float, rotate_xy(match.yaw_rad, static.box.centre) + match.shift),
            static.box.length_m,
            static.box.width_m,
            float(static.box.yaw_rad + match.yaw_rad),
            static.height_m,
        ]
        for static in calibration.drive.background.boxes
    ]


def to_text(document: Document) -> str:
    """Return indented JSON with lists of numbers, such as a matrix's rows, on one line."""
    text = json.dumps(document, indent=2, allow_nan=False)
    # JSON strings contain no raw line breaks, so the pattern matches lists only.
    return re.sub(r"\[\n\s*([-+.,\deE\s]+?)\s*\]", _on_one_line, text) + "\n"


def _on_one_line(row: re.Match[str]) -> str:
    return "[" + re.sub(r",\s+", ", ", row[1]) + "]"
