"""Combines several drives past one sensor into one ground, one level frame and one estimate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.alike import check_alike
from laci_stereo.core.common_ground import along_ground, lay, merge_grounds
from laci_stereo.core.conclusion import conclude
from laci_stereo.core.errors import MatchError
from laci_stereo.core.estimation.agreement import LeftOut, all_agree, estimates_of, fit_together
from laci_stereo.core.estimation.evidence import Evidence, evidence_of
from laci_stereo.core.estimation.joint import HELD_ROWS, JointFit, fit_jointly
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.placement.place import place
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import Settings
from laci_stereo.core.threads import in_one_thread

LANE_M = 3.0
"""Least distance of a stranger from the sender for which it is taken: a lane's width, or a vehicle's length."""

IN_VIEW_NS = 60_000_000_000
"""Least time between two drives that are independent: within a minute, both may have mistaken the same stranger."""


@dataclass(frozen=True)
class Share:
    """A drive's own part of the combined estimate.

    Attributes
    ----------
    name : str
    station_id : int
    frames : int
        Number of frames in which its vehicle was seen.
    time_offset_s, time_sigma_s : float
        To be added to the sensor's stamps to get the CAMs' time, and its standard deviation.
    """

    name: str
    station_id: int
    frames: int
    time_offset_s: float
    time_sigma_s: float

    def __str__(self) -> str:
        clock = f"{1e3 * self.time_offset_s:.1f} +- {1e3 * self.time_sigma_s:.1f} ms"
        return f"{self.name}: station {self.station_id}, {self.frames} frames, clock offset {clock}"


@dataclass(frozen=True)
class Combined:
    """A calibration from several drives.

    Attributes
    ----------
    calibration : Calibration
        Its own drive is the most informative one; ``others`` are the rest.
    shares : tuple of Share
        In the order of the calibration's passages.
    left_out : tuple of LeftOut
    """

    calibration: Calibration
    shares: tuple[Share, ...]
    left_out: tuple[LeftOut, ...]


@in_one_thread
def combine(passages: Sequence[Passage], settings: Settings | None = None) -> Combined:
    """Estimate the pose of a sensor from several drives, of one vehicle or several.

    Parameters
    ----------
    passages : sequence of Passage
        At least one; of one sensor, in one UTM zone.
    settings : Settings
        Its priors of the times, of clocks and between images, are replaced by the widest of the drives.

    Raises
    ------
    EvidenceError
        If they cannot be of one sensor, or one is there twice.
    CombineError
        If the sensor was moved between them, or too many contradict one another.
    CalibrationError
        If they do not determine a transform.
    """
    settings = _as_loose(settings or Settings(), passages)
    check_alike(passages)
    merged = merge_grounds(passages)
    laid = along_ground([lay(passages[i], merged.ground, passages[0].world) for i in merged.kept])
    drives = [evidence_of(each.track, each.vehicle, merged.ground.height_m) for each in laid]
    alone = _fit_alone(laid, drives, settings)
    together = fit_together(laid, drives, alone, settings.joint)
    names = [each.name for each in together.passages]
    placement = place(together.fit, together.drives, together.sightings, settings, names)
    fits = {each.name: fit for each, fit in zip(laid, alone, strict=True)}
    objections = (*merged.objections, *together.objections, *_repeated(together.passages, fits))
    placement = replace(placement, contradictions=(*placement.contradictions, *objections))
    calibration = conclude(together.passages, placement, settings)
    shares = (
        Share(each.name, each.station_id, len(each.track.sightings), each.time_offset_s, sigma_s)
        for each, sigma_s in zip(together.passages, together.fit.time_sigmas_s, strict=True)
    )
    return Combined(calibration, tuple(shares), together.left_out)


def _repeated(passages: Sequence[Passage], alone: Mapping[str, JointFit]) -> list[str]:
    """Return what was objected to drives when each was calibrated, unless others refute it; drives are named."""
    drives: dict[str, list[str]] = {}
    for one in passages:
        refuted = any(_refutes(other, one, alone) for other in passages)
        for objection in (*([one.by_chance] if one.by_chance and not refuted else []), *one.objections):
            drives.setdefault(objection, []).append(one.name)
    return [f"{', '.join(filter(None, names))}: {words}".removeprefix(": ") for words, names in drives.items()]


def _refutes(other: Passage, one: Passage, alone: Mapping[str, JointFit]) -> bool:
    """Tell whether another drive shows that the track of this one is no stranger's.

    That is if it is of another time, and places the sensor nearer to where this one does than a stranger would.
    """
    (first_ns, last_ns), (begin_ns, end_ns) = one.span_ns, other.span_ns
    if max(begin_ns - last_ns, first_ns - end_ns) < IN_VIEW_NS:
        return False
    fit, others = alone[one.name], alone[other.name]
    place = (fit.centre_level + others.centre_level) / 2.0
    off_m = float(np.linalg.norm(fit.match(place[None])[0] - others.match(place[None])[0]))
    covariance = (fit.covariance_about(place) + others.covariance_about(place))[1:, 1:]
    return off_m + 3.0 * float(np.sqrt(np.linalg.eigvalsh(covariance)[-1])) < LANE_M


def _as_loose(settings: Settings, passages: Sequence[Passage]) -> Settings:
    joint = replace(
        settings.joint,
        clock_sigma_s=max(passage.clock_sigma_s for passage in passages),
        apart_sigma_s=max(passage.apart_sigma_s for passage in passages),
    )
    return replace(settings, method="joint", joint=joint)


def _fit_alone(passages: Sequence[Passage], drives: Sequence[Evidence], settings: Settings) -> list[JointFit]:
    """Return the estimate from each drive by itself.

    With several drives, mistakes in the messages are considered only if the drives disagree.
    """
    if len(drives) == 1:
        return [_fit_one(passages[0], drives[0], settings, mistakes=True)]
    held = [(passage, drive.thinned(HELD_ROWS)) for passage, drive in zip(passages, drives, strict=True)]
    alone = [_fit_one(*each, settings, mistakes=False) for each in held]
    if all_agree(estimates_of(alone, [passage.station_id for passage in passages])):
        return alone
    return [_fit_one(*each, settings, mistakes=True) for each in held]


def _fit_one(passage: Passage, drive: Evidence, settings: Settings, *, mistakes: bool) -> JointFit:
    """Return the estimate from one drive; if its passage has one, the new one is close to it, on another ground."""
    start, offsets_s, close = passage.match, [passage.time_offset_s], passage.method == "joint"
    try:
        return fit_jointly([drive], start, offsets_s, settings.joint, close=close, mistakes=mistakes)
    except MatchError as error:
        raise MatchError(f"{passage.name}: {error}") from error
