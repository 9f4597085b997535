"""The page's statements and figures, each with a short explanation."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone

import numpy as np

from laci_stereo.core.estimation.drive_prior import Correction
from laci_stereo.core.frames import FloatArray, planar
from laci_stereo.core.result import Calibration, viewing_angles
from laci_stereo.io.result.calibration_file import Provenance
from laci_stereo.report.page.residuals import SIDES, Laid
from laci_stereo.report.summary import LEFT_OUT, others_of

DIGITS = 9
"""Decimal places of a transform's elements: a nanometre in a translation; in a rotation, less than a micrometre at a
distance of a kilometre."""

NOTABLE = 2.0
"""Standard deviations beyond which a correction is called notable: one in twenty exceeds them by chance."""

FEWEST = 5
"""Least number of points of a side for which their median is shown."""


@dataclass(frozen=True)
class Fact:
    """A quantity, its value, and its meaning for readers who do not know the coordinate frames."""

    name: str
    value: str
    meaning: str


@dataclass(frozen=True)
class Matrix:
    """A transform to be copied; ``text`` is the 4x4 matrix as JSON."""

    name: str
    meaning: str
    text: str


@dataclass(frozen=True)
class Verdict:
    """The verdict: its word, a sentence on whether the result can be used, the reasons, and what to do next."""

    word: str
    sentence: str
    reasons: tuple[str, ...]
    todo: tuple[str, ...]


def verdict_of(calibration: Calibration, has_image: bool, contradicted: bool) -> Verdict:
    """Return whether the result can be used, in one sentence, and what to do next.

    Parameters
    ----------
    calibration : Calibration
    has_image : bool
        Whether the page shows a camera image.
    contradicted : bool
        Whether the lane check failed, so that the map contradicts the result.
    """
    quality = calibration.quality
    known = (
        f"objects on the vehicle's path are placed on the map to ±{quality.track_xy_sigma_m:.2f} m and the viewing "
        f"direction is known to ±{quality.yaw_sigma_deg:.2f}° (one standard deviation)"
    )
    sentences = {
        "pass": f"This calibration can be used: {known}.",
        "warn": f"Use this calibration with care: {known}, but there is something to check.",
        "fail": f"Do not use this calibration: {known}, which is not enough.",
    }
    if contradicted and quality.verdict == "warn":
        sentences["warn"] = (
            f"Do not use this calibration before it is clear whether it or the map is wrong. It claims: {known}."
        )
    look = (
        "Look at the image: the map's lines must lie on the road's, and both boxes on the vehicle."
        if has_image
        else "Look at the map: both tracks must lie on each other, and on the lane that was driven."
    )
    use = "Then use the transform below, or calibration.json, which lies beside this page and holds the same numbers."
    again = "Drive again, then calibrate anew; or put several drives together with “laci-stereo combine”."
    steps = {"pass": (look, use), "warn": ("Check what is named above.", look, use), "fail": (again,)}
    advice = f"To make it better: {quality.advice}." if quality.advice else ""
    todo = (*steps[quality.verdict], *filter(None, [advice]))
    return Verdict(quality.verdict, sentences[quality.verdict], quality.reasons, todo)


def matrices(calibration: Calibration, provenance: Provenance) -> tuple[Matrix, ...]:
    """Return the transforms, the one into UTM first."""
    world = calibration.world
    sensor = f"in the sensor's frame ({provenance.frame}), in metres,"
    east, north = world.origin_utm
    found = [
        Matrix(
            "T_utm_sensor",
            f"Takes a point (x, y, z, 1) {sensor} to UTM easting and northing ({world.crs}) and height over the "
            "ground. It is rigid and exact around the vehicle's track; away from there UTM's own scale makes "
            f"{1e4 * abs(1.0 - world.grid_scale):.0f} cm in 100 m.",
            _json(calibration.T_utm_sensor),
        ),
        Matrix(
            "T_world_sensor",
            f"The same, to a map in true metres: x grid east, y grid north, z height over the ground, from the point "
            f"E {east:.0f} m, N {north:.0f} m. UTM = that point + {world.grid_scale:.6f} · (x, y).",
            _json(calibration.T_world_sensor),
        ),
    ]
    if provenance.T_sensor_rectified is not None:
        found.append(
            Matrix(
                "T_world_rectified",
                "The same, from the rectified left camera, which has the lens' distortion and the stereo rig's "
                "misalignment taken out; use it with points from disparities.",
                _json(calibration.T_world_sensor @ provenance.T_sensor_rectified),
            )
        )
    return tuple(found)


def _json(T: FloatArray) -> str:
    cells = [[f"{value + 0.0:.{DIGITS}f}" for value in row] for row in np.round(T, DIGITS).tolist()]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    rows = [", ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in cells]
    return "[[" + "],\n [".join(rows) + "]]"


def place_facts(calibration: Calibration) -> tuple[Fact, ...]:
    """Return the sensor's position, height and viewing direction."""
    world, quality = calibration.world, calibration.quality
    xy = calibration.T_world_sensor[None, :2, 3]
    east, north = world.to_utm(xy)[0]
    latitude, longitude = world.to_geodetic(xy)[0]
    angles = calibration.viewing_angles
    north_yaw = world.yaw_from_heading(np.zeros(1), np.array([latitude]), np.array([longitude]))[0]
    bearing = (float(np.degrees(north_yaw)) - angles.yaw_deg) % 360.0
    return (
        Fact("Position", f"E {east:.3f} m, N {north:.3f} m", f"UTM easting and northing, {world.crs}"),
        Fact("Latitude, longitude", f"{latitude:.8f}°, {longitude:.8f}°", "WGS84; opens in any map"),
        Fact(
            "Height",
            f"{calibration.height_m:.3f} m ± {quality.height_sigma_m:.3f} m",
            "of the sensor's origin above the road, not above sea level",
        ),
        Fact(
            "Looks to",
            f"{angles.yaw_deg:.3f}° ± {quality.yaw_sigma_deg:.3f}°",
            "of the forward axis, seen from above, counter-clockwise from grid east (the map's x)",
        ),
        Fact("Compass bearing", f"{bearing:.2f}°", "the same direction, clockwise from true north"),
        Fact(
            "Looks down",
            f"{angles.down_deg:.3f}° ± {quality.tilt_sigma_deg:.3f}°",
            "of the forward axis below the horizon; negative is upwards",
        ),
        Fact("Rolled", f"{angles.roll_deg:.3f}°", "clockwise about the forward axis, seen from behind the sensor"),
    )


def doubt_facts(calibration: Calibration) -> tuple[Fact, ...]:
    """Return the result's uncertainty, its residual, and the amount of data that it is based on."""
    quality, drive = calibration.quality, calibration.drive
    seen = f"{quality.frames_used} of {quality.frames_seen}"
    size = f"{drive.vehicle.length_m:.2f} m × {drive.vehicle.width_m:.2f} m"
    return (
        Fact(
            "Position along the track",
            f"±{quality.track_xy_sigma_m:.3f} m",
            "position error on the map of an object on the vehicle's path, one standard deviation",
        ),
        Fact(
            "Weakest direction",
            f"±{quality.weakest_sigma_m:.3f} m towards {quality.weakest_yaw_deg:.0f}°",
            "counter-clockwise from grid east, and the opposite way",
        ),
        Fact(
            "Residual",
            f"{quality.residual_rms_m:.3f} m",
            f"root mean square of what the fit leaves, {_residual_of(calibration)}",
        ),
        Fact("Frames used", seen, "frames in the fit, of those that show the vehicle"),
        Fact(
            "Vehicle",
            f"station {drive.station_id}, {size}{others_of(calibration)}",
            "sender of the messages (CAM), and the size that they report",
        ),
    )


def _residual_of(calibration: Calibration) -> str:
    if calibration.drive.method == "paper":
        return "between both tracks"
    points = any(len(sighting.points) for sighting in calibration.drive.track.sightings)
    return "from the points to the vehicle's outline" if points else "from the boxes' middles to the vehicle's"


def clock_facts(calibration: Calibration) -> tuple[Fact, ...]:
    """Return the clock offset between sensor and messages, and its prior."""
    if calibration.drive.method == "paper":
        return (Fact("Clock offset", "taken as zero", "the paper's method does not estimate it"),)
    drive = calibration.drive
    offset, sigma, prior = drive.time_offset_s, calibration.time_sigma_s, drive.clock_sigma_s
    return (
        Fact(
            "Clock offset",
            f"{signed(1e3 * offset, 1)} ms ± {1e3 * sigma:.1f} ms",
            "to be added to the sensor's times to get the times of the messages; one standard deviation",
        ),
        Fact(
            "Prior",
            f"0 ms ± {1e3 * prior:.1f} ms",
            f"what was expected; the estimate is {abs(offset) / prior:.1f} of these standard deviations away",
        ),
    )


@dataclass(frozen=True)
class Corrected:
    """An estimated correction to the messages, in words.

    Attributes
    ----------
    what, value, expected : str
        The quantity, its correction, and the prior of the correction.
    sigmas : float
        The correction in standard deviations.
    judgement : str
        "as expected", "notable" or "contradiction".
    """

    what: str
    value: str
    expected: str
    sigmas: float
    judgement: str


_WORDS = {
    "heading": ("direction of the body against the heading sent, clockwise", 180.0 / np.pi, 2, "°"),
    "lag": ("headings sent are older than positions", 1e3, 0, " ms"),
    "ahead": ("position sent is behind the reference point", 1.0, 3, " m"),
    "left": ("position sent is to the right of the reference point", 1.0, 3, " m"),
    "length": ("length of the vehicle, more than sent", 1.0, 3, " m"),
    "width": ("width of the vehicle, more than sent", 1.0, 3, " m"),
}


def corrected(corrections: Sequence[Correction]) -> tuple[Corrected, ...]:
    """Describe corrections and compare them with their priors; the clock offset is left to `clock_facts`."""
    return tuple(_corrected(correction) for correction in corrections if correction.what != "clock")


def _corrected(correction: Correction) -> Corrected:
    what, factor, digits, unit = _WORDS[correction.what]
    sigmas = correction.surprise
    judgement = "contradiction" if correction.contradicts else "notable" if sigmas > NOTABLE else "as expected"
    value = f"{signed(factor * correction.value, digits)}{unit}"
    return Corrected(what, value, f"0 ± {factor * correction.sigma:.{digits}f}{unit}", sigmas, judgement)


@dataclass(frozen=True)
class Side:
    """Distances of the points from one side of the vehicle: their median and half of their interquartile range."""

    name: str
    points: int
    median_cm: str
    spread_cm: str


def sides(laid: Laid) -> tuple[Side, ...]:
    """Return the distances from each side that was seen, of the points attributed to the outline."""
    found = []
    for number, name in enumerate(SIDES):
        distances = 100.0 * laid.distance_m[(laid.face == number) & (laid.surface >= 0.5)]
        if len(distances) < FEWEST:
            continue
        low, median, high = np.quantile(distances, [0.25, 0.5, 0.75])
        found.append(Side(name, len(distances), signed(float(median), 1), f"{(high - low) / 2:.1f}"))
    return tuple(found)


@dataclass(frozen=True)
class Compared:
    """A quantity by this result and by the paper's method, and their difference."""

    name: str
    here: str
    paper: str
    apart: str


def beside_paper(calibration: Calibration) -> tuple[Compared, ...]:
    """Compare the paper's method with the result; empty where that method has no result."""
    paper, differs = calibration.paper, calibration.paper_differs
    if paper is None or differs is None:
        return ()
    T_paper = planar(paper.yaw_rad, paper.shift) @ calibration.T_level_sensor
    xy, xy_paper = (calibration.world.to_utm(T[None, :2, 3])[0] for T in (calibration.T_world_sensor, T_paper))
    yaw, yaw_paper = calibration.viewing_angles.yaw_deg, viewing_angles(T_paper, calibration.axes).yaw_deg
    turn = (yaw_paper - yaw + 180.0) % 360.0 - 180.0
    return (
        Compared("Easting", f"{xy[0]:.3f} m", f"{xy_paper[0]:.3f} m", f"{signed(xy_paper[0] - xy[0], 3)} m"),
        Compared("Northing", f"{xy[1]:.3f} m", f"{xy_paper[1]:.3f} m", f"{signed(xy_paper[1] - xy[1], 3)} m"),
        Compared("Looks to", f"{yaw:.3f}°", f"{yaw_paper:.3f}°", f"{signed(turn, 3)}°"),
        Compared("Objects on the track", "–", "–", f"{differs[0]:.3f} m apart (root mean square)"),
    )


@dataclass(frozen=True)
class DriveFacts:
    """Figures of one of several drives."""

    name: str
    station: int
    began: str
    frames: int
    vehicle: str
    clock_ms: str


def drives(calibration: Calibration) -> tuple[DriveFacts, ...]:
    """Return the figures of all drives from which the result was estimated."""
    found = []
    for number, passage in enumerate(calibration.passages, start=1):
        began = datetime.fromtimestamp(passage.span_ns[0] // 1_000_000_000, tz=timezone.utc)
        vehicle = passage.vehicle
        found.append(
            DriveFacts(
                f"{number}: {passage.name}" if passage.name else str(number),
                passage.station_id,
                f"{began:%Y-%m-%d %H:%M:%S} UTC",
                len(passage.track.sightings),
                f"{vehicle.length_m:.2f} m × {vehicle.width_m:.2f} m",
                signed(1e3 * passage.time_offset_s, 1),
            )
        )
    return tuple(found)


def left_out(calibration: Calibration) -> tuple[str, ...]:
    """Return how many frames that show the vehicle were not used, by reason, in words."""
    return tuple(f"{count} frames {LEFT_OUT[reason]}" for reason, count in sorted(calibration.quality.left_out.items()))


def settings(config: Mapping[str, object], above: str = "") -> Iterator[tuple[str, str]]:
    """Yield every setting's dotted name and value."""
    for name, value in config.items():
        if isinstance(value, Mapping):
            yield from settings(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", json.dumps(value, ensure_ascii=False, default=str)


def signed(value: float, digits: int) -> str:
    """Return a number with its sign, for the page."""
    return f"{round(value, digits) + 0.0:+.{digits}f}".replace("-", "−")
