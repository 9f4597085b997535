"""The quantities in a log of messages: names of their columns, units, ranges, and codes for missing values."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Set
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray
from laci_stereo.io.table import BAD_SHARE, TIMESTAMP, Column


@dataclass(frozen=True)
class Quantity(Column):
    """A column of numbers, and its encoding in ETSI TS 102 894-2.

    Attributes
    ----------
    unit : str
    etsi_per_unit : float
        Steps of the raw ETSI integer per ``unit``.
    unavailable : int
        The raw integer for "unavailable".
    lowest, highest : float
        Range of possible values, in ``unit``.
    out_of_range : int or None
        The raw integer for "out of range" (above the largest value that can be encoded), if the element has one.
    is_at_least : bool
        Whether an "out of range" value is replaced by the smallest value that it can stand for, instead of NaN: of a
        position error, knowing that it is at least so large is enough.
    """

    unit: str
    etsi_per_unit: float
    unavailable: int
    lowest: float
    highest: float
    out_of_range: int | None = None
    is_at_least: bool = False

    @property
    def codes(self) -> Mapping[str, int]:
        """The raw integers that stand for a missing value, by ETSI's name for them."""
        codes = {"unavailable": self.unavailable}
        if self.out_of_range is not None and not self.is_at_least:
            codes["out of range"] = self.out_of_range
        return codes

    def is_code(self, values: FloatArray, code: int) -> BoolArray:
        """Return which values are a raw code, as an integer or, if a logger converted it like a value, in ``unit``."""
        both = (code, code / self.etsi_per_unit)
        found: BoolArray = np.any([np.isclose(values, number, rtol=1e-12, atol=0.0) for number in both], axis=0)
        return found

    @property
    def least_beyond(self) -> float:
        """The smallest value, in ``unit``, that "out of range" can stand for; NaN where it is treated as missing."""
        if self.out_of_range is None or not self.is_at_least:
            return float("nan")
        return self.out_of_range / self.etsi_per_unit

    @property
    def etsi_text(self) -> str:
        """The step of the raw integer with its unit, such as ``0.1 deg``."""
        return f"{1 / self.etsi_per_unit:g} {self.unit}".replace("e-0", "e-")

    def possible(self, values: FloatArray) -> BoolArray:
        """Return which values are in the quantity's range; NaN counts as possible."""
        return np.isnan(values) | ((values >= self.lowest) & (values <= self.highest))


STATION_ID = Column("station_id", ("stationid", "station", "id", "senderid", "vehicleid"))

GENERATION_DELTA = Column("generationDeltaTime", ("gendeltatime",))
"""Column of the times of generation, of which `timestamp` is the reception then; see `generation_times`."""

DRIVE_DIRECTION = Column("driveDirection", ())
"""Column that tells where a vehicle drives backwards, as ETSI's name for it or its number; see `backwards`."""

POSITION_OF = Column("position_of", ())
"""Column that names the point on the vehicle that the positions are of, where it is not the CAM reference point."""

ANTENNA = "antenna"

LATITUDE = Quantity("latitude", ("lat", "latitudedeg", "latdeg"), "deg", 1e7, 900000001, -90.0, 90.0)
LONGITUDE = Quantity(
    "longitude", ("lon", "lng", "long", "longitudedeg", "londeg"), "deg", 1e7, 1800000001, -180.0, 180.0
)
HEADING = Quantity(
    "heading", ("headingdeg", "headingvalue", "course", "coursedeg", "cog"), "deg", 10, 3601, -180.0, 360.0
)
SPEED = Quantity(
    "speed", ("speedmps", "speedms", "speedvalue", "velocity", "velocitymps"), "m/s", 100, 16383, 0.0, 130.0, 16382
)
LENGTH = Quantity(
    "vehicle_length", ("vehiclelengthm", "vehiclelengthvalue", "length", "lengthm"), "m", 10, 1023, 0.5, 60.0, 1022
)
WIDTH = Quantity("vehicle_width", ("vehiclewidthm", "width", "widthm"), "m", 10, 62, 0.3, 6.1, 61)
ALTITUDE = Quantity(
    "altitude",
    ("altitudem", "altitudevalue", "alt", "altm", "elevation", "ele"),
    "m",
    100,
    800001,
    -1000.0,
    9000.0,
    800000,
)
SEMI_MAJOR = Quantity(
    "semi_major_95",
    ("semimajor95m", "semimajoraxislength", "semimajorconfidence", "semimajor"),
    *("m", 100, 4095, 0.0, 100.0, 4094, True),
)
SEMI_MINOR = Quantity(
    "semi_minor_95",
    ("semiminor95m", "semiminoraxislength", "semiminorconfidence", "semiminor"),
    *("m", 100, 4095, 0.0, 100.0, 4094, True),
)
ELLIPSE_ORIENTATION = Quantity(
    "ellipse_orientation",
    ("ellipseorientationdeg", "semimajororientation", "semimajoraxisorientation"),
    *("deg", 10, 3601, -180.0, 360.0),
)

REQUIRED: tuple[Column, ...] = (TIMESTAMP, LATITUDE, LONGITUDE)
POSITION = (LATITUDE, LONGITUDE)
MOTION = (HEADING, SPEED)
DIMENSIONS = (LENGTH, WIDTH)
AXES = (SEMI_MAJOR, SEMI_MINOR)
_TOGETHER = ((HEADING,), (SPEED,), (ALTITUDE,), DIMENSIONS, AXES, (ELLIPSE_ORIENTATION,))
"""Columns that hold raw integers either all together or not at all; positions are decided separately."""

FIELDS: Mapping[Quantity, str] = {
    LATITUDE: "latitude_deg",
    LONGITUDE: "longitude_deg",
    HEADING: "heading_deg",
    SPEED: "speed_mps",
    ALTITUDE: "altitude_m",
    LENGTH: "length_m",
    WIDTH: "width_m",
    SEMI_MAJOR: "semi_major_95_m",
    SEMI_MINOR: "semi_minor_95_m",
    ELLIPSE_ORIENTATION: "ellipse_orientation_deg",
}
"""The field of a `CamLog` that holds each quantity."""

QUANTITIES = tuple(FIELDS)
COLUMNS: tuple[Column, ...] = (TIMESTAMP, STATION_ID, *QUANTITIES)

Values: TypeAlias = Mapping[Quantity, FloatArray]
"""The values of each quantity, shape (n,), NaN where missing."""


def in_units(raw_or_not: Values, pointed: Set[Quantity] = frozenset()) -> tuple[Values, list[str]]:
    """Convert the columns that hold raw ETSI integers to units, and return notes on which these are.

    Parameters
    ----------
    raw_or_not : mapping of Quantity to ndarray, shape (n,)
        Values in either encoding; infinite for "out of range".
    pointed : set of Quantity
        The columns in which numbers are written with a decimal point.
    """
    positions = _positions_look_raw(np.concatenate([raw_or_not[quantity] for quantity in POSITION]))
    # If even raw positions have a decimal point, the writer appends one to all numbers, so it says nothing.
    as_positions = positions and not pointed & set(POSITION)
    raw = {
        quantity
        for group in _TOGETHER
        if _look_raw({quantity: raw_or_not[quantity] for quantity in group}, pointed if as_positions else (), positions)
        for quantity in group
    } | set(POSITION if positions else ())
    values = {
        quantity: found / quantity.etsi_per_unit if quantity in raw else found for quantity, found in raw_or_not.items()
    }
    values = {quantity: np.where(np.isinf(found), quantity.least_beyond, found) for quantity, found in values.items()}
    units = [
        f"{quantity.name}: raw ETSI integers of {quantity.etsi_text}" for quantity in QUANTITIES if quantity in raw
    ]
    return values, units


def _look_raw(values: Values, pointed: Collection[Quantity], positions_are_raw: bool) -> bool:
    """Return whether a group of columns that are encoded alike holds raw ETSI integers.

    They do if the values are whole numbers and the median of one column is impossible in its unit: a length of 47 is
    possible both in metres and in decimetres, but a width of 18 only in decimetres. They also do if the positions are
    raw and every column of the group is possible as raw integers and has no decimal point.
    """
    known = {quantity: found[np.isfinite(found)] for quantity, found in values.items() if np.isfinite(found).any()}
    if not known or not all(map(_are_whole, known.values())):
        return False
    if any(np.median(np.abs(found)) > quantity.highest for quantity, found in known.items()):
        return True
    return positions_are_raw and all(
        quantity not in pointed and np.median(found) / quantity.etsi_per_unit >= quantity.lowest
        for quantity, found in known.items()
    )


def _positions_look_raw(values: FloatArray) -> bool:
    """Return whether latitudes and longitudes are whole numbers too large for degrees."""
    # In either encoding, zero stands for an unknown position.
    values = values[np.isfinite(values) & (values != 0)]
    return _are_whole(values) and bool(np.median(np.abs(values)) > LONGITUDE.highest)


def _are_whole(values: FloatArray) -> bool:
    return len(values) > 0 and float(np.mean(values == np.round(values))) >= 1 - BAD_SHARE
