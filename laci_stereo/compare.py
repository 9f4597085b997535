"""Comparison of results of one sensor: the repetition error, and whether they agree within their uncertainties.

The paper's table (Mueller et al., ITSC 2019, section on repeatability) has the differences of the transform's angles
and of its translation between two drives. What matters on the road is another quantity: by how much the position of
objects on the vehicle's path differs.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

from laci_stereo.core.errors import CalibrationFileError
from laci_stereo.core.estimation.passage import Passage, utc
from laci_stereo.core.frames import FloatArray, invert, planar, rotate_xy, transform, wrap
from laci_stereo.io.output import EVIDENCE_FILE
from laci_stereo.io.result.evidence_file import read_evidence
from laci_stereo.io.result.stored_calibration import StoredCalibration, read_calibration

CONTRADICTION_RATE = 0.01
"""Fraction of pairs of results with correct covariances that are reported as contradictory."""

SELDOM = 1e-6
"""Share of cases below which it is said that it is less."""

FARTHEST_M = 1000.0
"""Largest distance between two results of one sensor: a larger one is between different masts."""

DIGITS = {"deg": 3, "m": 3}

LEAST_SIGMA = 1e-6
"""Least standard deviation of a result, radians and metres: smaller ones are only rounding."""

OBJECTS = "objects on the tracks"

Outcome = Literal["agree", "contradict", "cannot tell"]


@dataclass(frozen=True)
class Difference:
    """Difference of one quantity between two results.

    Attributes
    ----------
    name : str
    value, sigma : float
        Absolute difference, and its standard deviation according to both covariances; NaN if one result has none.
    unit : str
    """

    name: str
    value: float
    sigma: float
    unit: str


@dataclass(frozen=True)
class Comparison:
    """Comparison of two results of one sensor.

    Attributes
    ----------
    first, second : str
        Paths of the results.
    differences : tuple of Difference
        The paper's three angles (roll about the forward axis, down, yaw about the vertical) and the three coordinates
        of the sensor; then the displacement of objects on the tracks in the plane, and the angle of the whole rotation
        between both.
    chi_square, probability : float
        Chi-square of all six parameters under both covariances, and the probability that results with correct
        covariances differ by at least as much; NaN where one has no covariance.
    shared : tuple of str
        The drives from which both were estimated, in words: by these they agree, right or wrong.
    """

    first: str
    second: str
    differences: tuple[Difference, ...]
    chi_square: float
    probability: float
    shared: tuple[str, ...] = ()

    @property
    def outcome(self) -> Outcome:
        """Whether the results agree within their uncertainties."""
        if np.isnan(self.probability):
            return "cannot tell"
        return "agree" if self.probability >= CONTRADICTION_RATE else "contradict"


def compare(results: Sequence[Path | str], *, renamed: bool = False) -> tuple[Comparison, ...]:
    """Compare results of one sensor, each with each.

    Parameters
    ----------
    results : sequence of path
        Result folders, or their ``calibration.json``; at least two.
    renamed : bool
        Whether they are of one sensor although their names for it differ.

    Raises
    ------
    CalibrationFileError, EvidenceError
        If one cannot be read, or they differ in sensor or frame.
    """
    if len(results) < 2:
        raise CalibrationFileError(f"{len(results)} result; needed are at least 2 to compare")
    stored = [read_calibration(Path(result)) for result in results]
    for other in stored[1:]:
        _check_same(stored[0], other)
        if other.name != stored[0].name and not renamed:
            raise CalibrationFileError(
                f"{other.path}: the sensor's name is {other.name!r}; needed is {stored[0].name!r} as in "
                f"{stored[0].path}, or --renamed if it is the same sensor"
            )
    drives = [_drives_of(one) for one in stored]
    tracks = [_track_of(*each) for each in zip(stored, drives, strict=True)]
    pairs = combinations(range(len(stored)), 2)
    return tuple(
        replace(compare_two(stored[i], stored[j], tracks[i], tracks[j]), shared=_shared(drives[i], drives[j]))
        for i, j in pairs
    )


def _check_same(one: StoredCalibration, other: StoredCalibration) -> None:
    """Raise if two results are not of one sensor, or not in comparable frames."""
    for what, of_one, of_other in (
        ("the sensor's kind", one.kind, other.kind),
        ("the sensor's frame", one.frame, other.frame),
    ):
        if of_one != of_other:
            raise CalibrationFileError(f"{other.path}: {what} is {of_other!r}; needed is {of_one!r} as in {one.path}")
    apart_m = float(np.linalg.norm(_world_in(other, one)[:2, 3]))
    if not apart_m <= FARTHEST_M:
        of_one, of_other = (f" ({each.world.crs})" if one.world.crs != other.world.crs else "" for each in (one, other))
        raise CalibrationFileError(
            f"{other.path}: its tracks{of_other} are {apart_m:.0f} m from those in {one.path}{of_one}; needed are at "
            f"most {FARTHEST_M:.0f} m: is it the same sensor?"
        )


def _world_in(other: StoredCalibration, one: StoredCalibration) -> FloatArray:
    """Return the transform from the world of ``other`` to that of ``one``, shape (4, 4).

    The grids of two UTM zones are turned against each other by the difference of their meridian convergences. Both
    worlds are in true metres, so that a rotation and a translation suffice: exact at the other's centre, and to 3 mm
    100 m from it, as UTM's scale changes by less than 3e-8 per metre, even in a neighbouring zone, and a world's is
    that of its origin, at most `FARTHEST_M` away.
    """
    if other.world.crs == one.world.crs:
        return planar(0.0, one.world.from_utm(np.array([other.world.origin_utm]))[0])
    place = other.centre_world[None, :2]
    latitude_deg, longitude_deg = other.world.to_geodetic(place).T
    north_one, north_other = (
        float(each.world.yaw_from_heading(np.zeros(1), latitude_deg, longitude_deg)[0]) for each in (one, other)
    )
    turn_rad = north_one - north_other
    return planar(turn_rad, (one.world.from_geodetic(latitude_deg, longitude_deg) - rotate_xy(turn_rad, place))[0])


def _drives_of(stored: StoredCalibration) -> tuple[Passage, ...]:
    """Return the drives that a result was estimated from; empty where no evidence is kept."""
    evidence = stored.path.parent / EVIDENCE_FILE
    return read_evidence(evidence).passages if evidence.exists() else ()


def _track_of(stored: StoredCalibration, drives: Sequence[Passage]) -> FloatArray:
    """Return where the vehicles were seen, world, shape (n, 2): only the middle of that where no evidence is kept."""
    if not drives:
        return stored.centre_world[None, :2]
    return np.concatenate([drive.match(drive.track.centres) for drive in drives])


def _shared(some: Sequence[Passage], others: Sequence[Passage]) -> tuple[str, ...]:
    """Return in words the drives that are among both: of one station, at one time."""
    return tuple(
        f"station {one.station_id} at {utc(one.span_ns[0])} UTC"
        for one, other in product(some, others)
        if one.is_also(other)
    )


def compare_two(
    one: StoredCalibration, other: StoredCalibration, track_one: FloatArray, track_other: FloatArray
) -> Comparison:
    """Compare two results, in the world of the first, also where that is in another UTM zone.

    Parameters
    ----------
    one, other : StoredCalibration
    track_one, track_other : ndarray, shape (n, 2)
        Positions at which the displacement is evaluated, each in its own world.
    """
    T_world_other = _world_in(other, one)
    T_one, T_other = one.T_world_sensor, T_world_other @ other.T_world_sensor
    centre_other = transform(T_world_other, other.centre_world[None])[0]
    centre = (one.centre_world + centre_other) / 2
    T_apart = T_other @ invert(T_one)
    six = np.append(Rotation.from_matrix(T_apart[:3, :3]).as_rotvec(), transform(T_apart, centre[None])[0] - centre)
    covariance = _about(one.covariance, one.centre_world, centre)
    turned = np.kron(np.eye(2), T_world_other[:3, :3])
    covariance += _about(turned @ other.covariance @ turned.T, centre_other, centre) + LEAST_SIGMA**2 * np.eye(6)
    chi_square = float(six @ np.linalg.solve(covariance, six))
    turn_rad = float(np.arctan2(T_world_other[1, 0], T_world_other[0, 0]))
    track = np.concatenate([track_one, rotate_xy(turn_rad, track_other) + T_world_other[:2, 3]])
    differences = (
        *_angles(one.angles_deg, np.add(other.angles_deg, (0.0, 0.0, np.degrees(turn_rad))), covariance),
        *_shifts(T_other[:3, 3] - T_one[:3, 3], _about(covariance, centre, T_one[:3, 3])),
        _objects(T_apart, track, centre, covariance),
        _turn(six[:3], covariance[:3, :3]),
    )
    return Comparison(str(one.path), str(other.path), differences, chi_square, float(chdtrc(6, chi_square)))


def _about(covariance: FloatArray, centre: FloatArray, point: FloatArray) -> FloatArray:
    """Return a covariance of rotation and translation about ``centre`` as the covariance about ``point``."""
    arm = np.eye(6)
    arm[3:, :3] = -np.cross(np.eye(3), centre - point)
    moved: FloatArray = arm @ covariance @ arm.T
    return moved


def _angles(one_deg: Sequence[float], other_deg: FloatArray, covariance: FloatArray) -> Iterator[Difference]:
    """Yield the differences of roll, down and yaw, which are psi 1 to 3."""
    apart_deg = np.degrees(wrap(np.radians(np.subtract(other_deg, one_deg))))
    angles = Rotation.from_euler("ZYX", one_deg[::-1], degrees=True)
    step = 1e-6
    turned = [(Rotation.from_rotvec(step * axis) * angles).as_euler("ZYX")[::-1] for axis in np.eye(3)]
    jacobian = np.column_stack([wrap(each - angles.as_euler("ZYX")[::-1]) / step for each in turned])
    sigmas_deg = np.degrees(np.sqrt(np.diag(jacobian @ covariance[:3, :3] @ jacobian.T)))
    for number, (name, value, sigma) in enumerate(zip(("roll", "down", "yaw"), apart_deg, sigmas_deg, strict=True), 1):
        yield Difference(f"|d psi_{number}| ({name})", abs(float(value)), float(sigma), "deg")


def _shifts(apart_m: FloatArray, covariance: FloatArray) -> Iterator[Difference]:
    for number, axis in enumerate(("x, east", "y, north", "z, up")):
        name = f"|d{axis[0]}|{axis[1:]}"
        yield Difference(name, abs(float(apart_m[number])), float(np.sqrt(covariance[3 + number, 3 + number])), "m")


def _objects(T_apart: FloatArray, track: FloatArray, centre: FloatArray, covariance: FloatArray) -> Difference:
    """Return the displacement of points on the tracks in the plane, root mean square."""
    points = np.column_stack([track, np.zeros(len(track))])
    apart_m = float(np.sqrt(((transform(T_apart, points) - points)[:, :2] ** 2).sum(axis=1).mean()))
    variances = [
        np.trace(_about(covariance, centre, point)[3:5, 3:5]) for point in points[:: max(len(points) // 50, 1)]
    ]
    return Difference(OBJECTS, apart_m, float(np.sqrt(np.mean(variances))), "m")


def _turn(rotation: FloatArray, covariance: FloatArray) -> Difference:
    sigma = float(np.degrees(np.sqrt(np.trace(covariance))))
    return Difference("whole rotation", float(np.degrees(np.linalg.norm(rotation))), sigma, "deg")


SHARED = (
    "The sigmas take both results as independent. What they share, such as the camera's own calibration or the "
    "sender's lever arm, moves both alike and does not show: they are upper bounds, and agreement does not say that "
    "both are right."
)


_VERDICTS: Mapping[Outcome, str] = {
    "agree": "AGREE",
    "contradict": "CONTRADICT EACH OTHER",
    "cannot tell": "CANNOT TELL",
}


def to_table(comparison: Comparison) -> str:
    """Return a comparison as a table for a terminal."""
    lines = [
        f"{comparison.first} and {comparison.second}",
        f"{'':<24}{'apart':>14}{'claimed sigma':>16}{'in sigmas':>11}",
    ]
    for each in comparison.differences:
        value, sigma = (f"{number:.{DIGITS[each.unit]}f} {each.unit}" for number in (each.value, each.sigma))
        in_sigmas = f"{sigma:>16}{each.value / each.sigma:>11.1f}" if np.isfinite(each.sigma) else f"{'unknown':>16}"
        lines.append(f"{each.name:<24}{value:>14}{in_sigmas}")
    lines.append(f"{'Verdict':<11}{_VERDICTS[comparison.outcome]}: {chance(comparison)}")
    return "\n".join(lines)


def to_summary(comparisons: Sequence[Comparison]) -> str:
    """Return lines on how each of several results compares with the others; nothing for a single pair."""
    if len(comparisons) < 2:
        return ""
    counts = Counter(one.outcome for one in comparisons)
    told = ", ".join(f"{counts[outcome]} {words.lower()}" for outcome, words in _VERDICTS.items() if counts[outcome])
    results = list(dict.fromkeys(name for one in comparisons for name in (one.first, one.second)))
    width = max(map(len, results)) + 2
    lines = [
        f"{len(results)} results, {len(comparisons)} pairs: {told}",
        f"{'':<{width}}{'contradicts':>12}{'objects apart: median':>23}{'most':>9}",
    ]
    for name in results:
        own = [one for one in comparisons if name in (one.first, one.second)]
        apart_m = [each.value for one in own for each in one.differences if each.name == OBJECTS]
        contradicts = f"{sum(one.outcome == 'contradict' for one in own)} of {len(own)}"
        lines.append(f"{name:<{width}}{contradicts:>12}{np.median(apart_m):>21.3f} m{max(apart_m):>7.3f} m")
    return "\n".join(lines)


def chance(comparison: Comparison) -> str:
    """Return words on how likely the differences are."""
    if comparison.outcome == "cannot tell":
        return "one of them was imported and claims nothing, so only by how much they differ can be said"
    words = (
        f"chi-square {comparison.chi_square:.1f} of 6; results that are as good as they claim are so far apart in "
        f"{_percent(comparison.probability)} of cases, and contradict below {100 * CONTRADICTION_RATE:g} %"
    )
    if not comparison.shared:
        return words
    return f"{words}; both are of the same drive, of {' and of '.join(comparison.shared)}, which agrees with itself"


def _percent(share: float) -> str:
    if share < SELDOM:
        return f"less than {100 * SELDOM:g} %"
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.2g} %"


def to_csv(comparisons: Sequence[Comparison]) -> str:
    """Return comparisons as CSV, a row for each."""
    names = ("psi_1", "psi_2", "psi_3", "x", "y", "z", "objects", "rotation")
    header = ["first", "second"]
    for name, each in zip(names, comparisons[0].differences, strict=True):
        header += [f"d_{name}_{each.unit}", f"sigma_{name}_{each.unit}"]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*header, "chi_square", "probability", "verdict"])
    for one in comparisons:
        values = [number for each in one.differences for number in (each.value, each.sigma)]
        numbers = ["" if np.isnan(value) else f"{value:.6g}" for value in (*values, one.chi_square, one.probability)]
        writer.writerow([one.first, one.second, *numbers, one.outcome])
    return text.getvalue()
