"""Logs of a GNSS receiver, read as messages of the one vehicle that carried it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, TypeAlias, TypeVar

import numpy as np

from laci_stereo.core.errors import CamError
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.messages.cam import ELLIPSE_SIGMAS, MAX_GAP_S
from laci_stereo.io.cam.columns import (
    ELLIPSE_ORIENTATION,
    HEADING,
    LATITUDE,
    LONGITUDE,
    SEMI_MAJOR,
    SEMI_MINOR,
    SPEED,
    Quantity,
    Values,
)
from laci_stereo.io.cam.etsi import DamagedError
from laci_stereo.io.cam.recording import CamRecording, Messages, recorded

STATION = 0
"""The station number of a receiver, which is no ITS station."""

OF_ANTENNA = (
    "its positions are the antenna's; needed is where that is on the vehicle: --cam-reference X,Y, metres ahead and "
    "left of the vehicle's middle, such as --cam-reference=-0.4,0, or front if they were moved there"
)
"""Note on the antenna's lever arm: an error of metres that no result reveals, because along a straight road it is
indistinguishable from a shift of the sensor."""

Fix: TypeAlias = tuple[int, Mapping[Quantity, float]]
"""Unix time in nanoseconds, and the known quantities."""

Record = TypeVar("Record")

# WGS84
_SEMI_MAJOR_AXIS_M = 6_378_137.0
_ECCENTRICITY_SQUARED = 6.694379990141e-3


def fixes_in(
    records: Iterable[tuple[int, Record]], fix: Callable[[Record], Fix]
) -> tuple[dict[int, Fix], dict[int, str]]:
    """Return the fixes in numbered records, and why others cannot be read: for what ``fix`` raises `DamagedError`."""
    fixes, problems = {}, {}
    for place, record in records:
        try:
            fixes[place] = fix(record)
        except DamagedError as problem:
            problems[place] = str(problem)
    return fixes, problems


def gnss_messages(path: Path, noun: str, fixes: Mapping[int, Fix], problems: Mapping[int, str]) -> Messages:
    """Return fixes in the form of messages.

    Parameters
    ----------
    path : Path
    noun : str
        The format's noun for the record of a fix.
    fixes : mapping of int to Fix
        By record number.
    problems : mapping of int to str
        The records that could not be read, with the reason, by record number.
    """
    places = sorted({*fixes, *problems})
    stamped = [fixes.get(place, (0, {})) for place in places]
    quantities = {quantity for _, values in stamped for quantity in values} | {LATITUDE, LONGITUDE}
    return Messages(
        path,
        noun,
        places,
        np.array([stamp_ns for stamp_ns, _ in stamped], dtype=np.int64),
        np.full(len(stamped), STATION, dtype=np.int64),
        {
            quantity: np.array([values.get(quantity, np.nan) for _, values in stamped], dtype=np.float64)
            for quantity in quantities
        },
        {i: problems[place] for i, place in enumerate(places) if place in problems},
    )


def recorded_drive(messages: Messages, notes: Sequence[str], file_format: str) -> CamRecording:
    """Return the log of a GNSS receiver's fixes; heading and speed follow from the motion where the file lacks them.

    Raises
    ------
    CamError
        As in `recorded`, or if there is no fix at all.
    """
    if len(messages) == 0:
        raise CamError(f"{messages.path} is {file_format} and holds no position; needed are at least 2")
    notes = [
        *notes,
        f"no station_id in {file_format}; all is taken for one station, {STATION}",
        f"no vehicle_length and vehicle_width in {file_format}",
        OF_ANTENNA,
    ]
    messages, motion_notes = _with_motion(messages)
    return replace(recorded(messages, [*notes, *motion_notes], file_format), is_receiver=True)


def _with_motion(messages: Messages) -> tuple[Messages, list[str]]:
    missing = [
        quantity for quantity in (HEADING, SPEED) if not np.isfinite(messages.values.get(quantity, np.nan)).any()
    ]
    if not missing:
        return messages, []
    good = np.array([i not in messages.problems for i in range(len(messages))], dtype=bool)
    motion = _motion(
        np.where(good, messages.stamps_ns, 0),
        np.where(good, messages.values[LATITUDE], np.nan),
        np.where(good, messages.values[LONGITUDE], np.nan),
    )
    values = {**messages.values, **{quantity: motion[quantity] for quantity in missing}}
    names = " and ".join(quantity.name for quantity in missing)
    return replace(messages, values=values), [f"no {names}; from the motion of the positions"]


def _motion(stamps_ns: IntArray, latitude_deg: FloatArray, longitude_deg: FloatArray) -> Values:
    """Return heading and speed from positions, shape (n,) each, NaN where no neighbour in time exists."""
    heading, speed = np.full(len(stamps_ns), np.nan), np.full(len(stamps_ns), np.nan)
    located = np.flatnonzero(np.isfinite(latitude_deg) & (np.abs(latitude_deg) <= LATITUDE.highest))
    located = located[np.isfinite(longitude_deg[located])]
    _, first, inverse = np.unique(stamps_ns[located], return_index=True, return_inverse=True)
    order = located[first]
    seconds = (stamps_ns[order] - stamps_ns[order[:1]]) / 1e9
    north, east = np.full(len(order), np.nan), np.full(len(order), np.nan)
    for drive in np.split(np.arange(len(order)), np.flatnonzero(np.diff(seconds) > MAX_GAP_S) + 1):
        if len(drive) >= 2:
            fixes = order[drive]
            north[drive], east[drive] = _velocity(seconds[drive], latitude_deg[fixes], longitude_deg[fixes])
    heading[located] = (np.degrees(np.arctan2(east, north)) % 360.0)[inverse]
    speed[located] = np.hypot(north, east)[inverse]
    return {HEADING: heading, SPEED: speed}


def _velocity(
    seconds: FloatArray, latitude_deg: FloatArray, longitude_deg: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the velocities to the north and to the east, m/s, shape (n,), by second-order finite differences."""
    latitude = np.radians(latitude_deg)
    longitude = np.unwrap(np.radians(longitude_deg))
    squeezed = 1.0 - _ECCENTRICITY_SQUARED * np.sin(latitude) ** 2
    of_meridian_m = _SEMI_MAJOR_AXIS_M * (1.0 - _ECCENTRICITY_SQUARED) / squeezed**1.5
    of_parallel_m = _SEMI_MAJOR_AXIS_M * np.cos(latitude) / np.sqrt(squeezed)
    order: Literal[1, 2] = 2 if len(seconds) > 2 else 1
    to_north = np.gradient(latitude.tolist(), seconds, edge_order=order)
    to_east = np.gradient(longitude.tolist(), seconds, edge_order=order)
    return of_meridian_m * to_north, of_parallel_m * to_east


def ellipse_95(covariance_east_north: FloatArray) -> Mapping[Quantity, float]:
    """Return the 95 % ellipse of a horizontal covariance, shape (2, 2), m^2; empty if that is invalid."""
    if not np.isfinite(covariance_east_north).all():
        return {}
    variances, axes = np.linalg.eigh(covariance_east_north)
    if variances[0] < 0 or variances[1] <= 0:
        return {}
    minor_m, major_m = (ELLIPSE_SIGMAS * np.sqrt(variances)).tolist()
    along = float(np.degrees(np.arctan2(axes[0, 1], axes[1, 1])) % 180.0)
    return {SEMI_MAJOR: major_m, SEMI_MINOR: minor_m, ELLIPSE_ORIENTATION: along}
