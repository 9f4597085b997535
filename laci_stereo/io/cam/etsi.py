"""A CAM's quantities as ETSI TS 102 894-2 encodes them, independent of the serialisation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray
from laci_stereo.io.cam.columns import (
    ALTITUDE,
    ELLIPSE_ORIENTATION,
    HEADING,
    LATITUDE,
    LENGTH,
    LONGITUDE,
    SEMI_MAJOR,
    SEMI_MINOR,
    SPEED,
    WIDTH,
    Quantity,
    Values,
)

BACKWARD = 1
"""Value of driveDirection for a vehicle in reverse."""

_PDU_KINDS: Mapping[int, str] = {
    1: "DENM",
    2: "CAM",
    4: "SPATEM",
    5: "MAPEM",
    6: "IVIM",
    9: "SREM",
    10: "SSEM",
    14: "CPM",
    16: "VAM",
}
"""Kind of message by messageID (TS 102 894-2)."""

_SHORT_NAMES: Mapping[str, str] = {"SPATEM": "SPAT", "MAPEM": "MAP", "IVIM": "IVI", "SREM": "SRM", "SSEM": "SSM"}
"""What the body of a message is called, where that is not its kind: the standards of the roadside are of SAE J2735."""

CAM_KIND = "CAM"


class OtherKindError(Exception):
    """An intact message that is not a vehicle's CAM; the text is its kind."""


class DamagedError(Exception):
    """A message that should be a CAM or a fix but cannot be read; the text is the reason."""


class Cam(NamedTuple):
    """Content of a vehicle's CAM as raw ETSI integers."""

    station_id: int
    delta_ms: int
    latitude: int
    longitude: int
    semi_major: int
    semi_minor: int
    orientation: int
    altitude: int
    heading: int
    speed: int
    drive_direction: int
    length: int
    width: int


_ELEMENTS: Mapping[Quantity, str] = {
    LATITUDE: "latitude",
    LONGITUDE: "longitude",
    HEADING: "heading",
    SPEED: "speed",
    ALTITUDE: "altitude",
    LENGTH: "length",
    WIDTH: "width",
    SEMI_MAJOR: "semi_major",
    SEMI_MINOR: "semi_minor",
    ELLIPSE_ORIENTATION: "orientation",
}

UNKNOWN = Cam(0, 0, 900000001, 1800000001, 4095, 4095, 3601, 800001, 3601, 16383, 2, 1023, 62)
"""A message in which every quantity is "unavailable"."""


def pdu_kind(message_id: int) -> str:
    """Return the kind of a message by the ``messageID`` in its header."""
    return _PDU_KINDS.get(message_id, f"ITS message {message_id}")


@lru_cache(maxsize=1 << 10)  # it is asked for the names in all records
def kind_named(name: str) -> str | None:
    """Return the kind of message that a name stands for, such as ``denm`` or ``Spat``; None if it stands for none."""
    plain = name.strip().upper().removesuffix("S")
    return next((kind for kind in _PDU_KINDS.values() if plain in (kind, _SHORT_NAMES.get(kind))), None)


def in_units(cams: Sequence[Cam]) -> Values:
    """Return the quantities in their units; NaN where unavailable, or out of range unless `Quantity.is_at_least`."""
    raw = np.array(cams, dtype=np.float64).reshape(-1, len(Cam._fields))
    return {quantity: _in_unit(quantity, raw[:, Cam._fields.index(element)]) for quantity, element in _ELEMENTS.items()}


def _in_unit(quantity: Quantity, raw: FloatArray) -> FloatArray:
    return np.where(np.isin(raw, list(quantity.codes.values())), np.nan, raw / quantity.etsi_per_unit)


def value_notes(values: Values, good: BoolArray) -> list[str]:
    """Return notes on the step of each raw integer, and on how often each quantity is missing or out of range.

    Parameters
    ----------
    values : mapping of Quantity to ndarray, shape (n,)
        As from `in_units`.
    good : ndarray of bool, shape (n,)
        The messages that could be read.
    """
    sent = ", ".join(f"{quantity.name} {quantity.etsi_text}" for quantity in values)
    missing = {quantity.name: int(np.isnan(found[good]).sum()) for quantity, found in values.items()}
    lacking = ", ".join(f"{name} in {count}" for name, count in missing.items() if count)
    lacking_note = f"unavailable or out of range, of {int(good.sum())} messages, taken as missing: {lacking}"
    beyond = [
        f"{quantity.name} is out of range in {count}: taken as {quantity.least_beyond:g} {quantity.unit}, the least "
        "that it means"
        for quantity, found in values.items()
        if (count := int(np.sum(found[good] == quantity.least_beyond)))
    ]
    return [f"ETSI integers of {sent}", *([lacking_note] if lacking else []), *beyond]
