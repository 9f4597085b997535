"""One scan: points in metres in the sensor frame, each with its time and intensity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_lidar.columns import Column, Columns
from laci_lidar.errors import ScanError
from laci_lidar.point_times import Clock, point_times
from laci_stereo.core.frames import BoolArray, FloatArray
from laci_stereo.io.text_file import listed

NO_RETURN_M = 0.01
"""Points nearer to the sensor's origin than this are the way in which scanners encode a missing return."""

FARTHEST_M = 1000.0
"""Maximum range of roadside LiDARs. Single points beyond it mark beams without return; if most points are beyond it,
coordinates are not in metres."""

TIME_NAMES = (
    "t",
    "time",
    "timestamp",
    "offsettime",
    "timeoffset",
    "timestampoffset",
    "offsettimestamp",
    "deltatime",
    "relativetime",
    "reltime",
    "pointtime",
    "gpstime",
    "ts",
    "timens",
    "timeus",
    "timestampns",
    "timeoffsetns",
    "offsetns",
    "pointtimeoffset",
    "relativetimestamp",
)
"""Names of a point's own time, in lower case, without underscores and without CloudCompare's prefix ``scalar_``."""

INTENSITY_NAMES = (
    "intensity",
    "i",
    "intensities",
    "reflectivity",
    "reflectance",
    "remission",
    "signal",
    "rssi",
    "amplitude",
)


@dataclass(frozen=True)
class Scan:
    """One scan.

    Attributes
    ----------
    points : ndarray, shape (n, 3)
        In the sensor frame, metres, finite; beams without return are left out.
    intensity : ndarray, shape (n,), or None
        Intensity in the sensor's own unit.
    offset_s : ndarray, shape (n,), or None
        Each point's own time after the scan's stamp, seconds.
    unused : tuple of str
        Names of fields that are none of these.
    clock : Clock
        Reference of the points' own times, as far as they have any.
    """

    points: FloatArray
    intensity: FloatArray | None = None
    offset_s: FloatArray | None = None
    unused: tuple[str, ...] = ()
    clock: Clock = "stamp"

    def __post_init__(self) -> None:
        n = len(self.points)
        assert self.points.shape == (n, 3), self.points.shape
        assert self.intensity is None or self.intensity.shape == (n,)
        assert self.offset_s is None or self.offset_s.shape == (n,)

    def __len__(self) -> int:
        return len(self.points)


# A damaged file may contain any bits: signalling NaN, and numbers whose square is infinite.
@np.errstate(invalid="ignore", over="ignore")
def scan_of(columns: Columns, what: str, stamp_ns: int | None = None) -> Scan:
    """Create a scan from the columns of a file or a message.

    Parameters
    ----------
    columns : Columns
        Contains at least ``x``, ``y`` and ``z`` in metres; names are not case-sensitive.
    what : str
        The file or message, for errors.
    stamp_ns : int or None
        Stamp of the scan, to which the points' own times may or may not refer. None: unknown.

    Raises
    ------
    ScanError
        If coordinates are missing or not in metres, or no point has a return.
    """
    plain = {_plain(name): column for name, column in columns.items()}
    if any(_first(plain, (axis,)) is None for axis in "xyz"):
        raise ScanError(f"{what} has the fields {listed(list(columns)) or '(none)'}; needed are x, y and z")
    if len(plain["x"]) == 0:
        raise ScanError(f"{what} is empty: it has 0 points")
    points = np.empty((len(plain["x"]), 3))
    for i, axis in enumerate("xyz"):
        points[:, i] = plain[axis]
    times = _first(plain, TIME_NAMES)
    keep, range_m = _returns(points, what)
    if times is not None:
        keep &= np.isfinite(times)
    median_m = float(np.median(range_m[keep])) if keep.any() else 0.0
    if median_m > FARTHEST_M:
        raise ScanError(
            f"{what}: the median distance of its points is {median_m:.4g} m; needed is at most {FARTHEST_M:.0f} m: are "
            "these millimetres, or coordinates on a map?"
        )
    keep &= range_m <= FARTHEST_M
    if not keep.any():
        raise ScanError(
            f"{what}: 0 of {len(points)} points have a return; needed are finite coordinates off the origin"
        )
    intensity = _first(plain, INTENSITY_NAMES)
    timing = None if times is None else point_times(times[keep], stamp_ns)
    if times is not None and timing is None and (times[keep] != 0).any():  # 0 marks points without a time
        timing = point_times(times[keep & (times != 0)], stamp_ns)
        keep &= (times != 0) | (timing is None)
    understood = {*"xyz", *INTENSITY_NAMES, *(TIME_NAMES if timing is not None else ())}
    return Scan(
        points[keep],
        None if intensity is None else intensity[keep].astype(np.float64),
        None if timing is None else timing.offset_s,
        tuple(name for name in columns if _plain(name) not in understood),
        "stamp" if timing is None else timing.clock,
    )


def _plain(name: str) -> str:
    return name.lower().removeprefix("scalar_").replace("_", "").replace(" ", "")


def _returns(points: FloatArray, what: str) -> tuple[BoolArray, FloatArray]:
    """Return which points are returns, and the distances of all points."""
    range_m = np.sqrt(np.einsum("ij,ij->i", points, points))
    finite = np.isfinite(points).all(axis=1)
    if not finite.any():
        raise ScanError(f"{what}: none of its {len(points)} points is finite; needed are numbers in metres")
    return finite & (range_m > NO_RETURN_M), range_m


def _first(columns: Columns, names: tuple[str, ...]) -> Column | None:
    """Return the first numeric column that has one of the names, or None."""
    found = (columns[name] for name in names if name in columns)
    return next((column for column in found if column.ndim == 1 and column.dtype.kind in "fiu"), None)
