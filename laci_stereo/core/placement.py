"""The placement of the level frame in the world by either estimator, its uncertainty, and the objections to it.

An objection is a reason, in words, why the result may be wrong. The messages contradict the points where a correction
to them exceeds its prior by far (`CONTRADICTED`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from laci_stereo.core.association.choice import Choice
from laci_stereo.core.association.pieces import LEAST_UNSEEN_M, unseen_m
from laci_stereo.core.association.riders import ridden_frames
from laci_stereo.core.errors import CombineError, MatchError, OpenError
from laci_stereo.core.estimation.agreement import agreeing, fit_together
from laci_stereo.core.estimation.drive_prior import Correction
from laci_stereo.core.estimation.evidence import Evidence, evidence_of
from laci_stereo.core.estimation.joint import HELD_ROWS, JointFit, fit_jointly
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.estimation.split_check import compare_halves, with_doubt
from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.matching import PlanarMatch, match_track
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.quality import Doubt, Placement, doubt_of
from laci_stereo.core.robust import NORMAL
from laci_stereo.core.settings import JointSettings, MatchSettings, Settings
from laci_stereo.core.tracking.tracks import Track
from laci_stereo.core.vehicle import outline

LEAST_EXPLAINED = 0.5
"""Least fraction of the points that the outline must explain; below it something else was registered."""

CONTRADICTED = 4.0
"""Number of standard deviations beyond which a correction contradicts the messages."""

ANOTHER_PIECE = (
    "what was seen may be another part of it, or its length wrong, and the position off by as much along the path"
)


def place_by_paper(track: Track, vehicle: VehicleTrack, settings: MatchSettings) -> Placement:
    """Match the boxes' centres with the positions of the messages (paper section III-D).

    A box whose longer side is nearer to the vehicle's width than to its length shows one end of the vehicle, not its
    middle. Such boxes are left out as too thin, unless too few others remain.

    Raises
    ------
    MatchError
        If the drive is too short to determine the yaw.
    """
    xy_world, _, known = vehicle.at(track.stamps_s)
    longer = np.array([max(sighting.box.length_m, sighting.box.width_m) for sighting in track.usable])
    whole = known & (longer > (vehicle.length_m + vehicle.width_m) / 2)
    used = whole if whole.sum() >= settings.min_frames else known
    xy_level, xy_world = track.centres[used], xy_world[used]
    match = match_track(xy_level, xy_world, settings)
    left_out = track.flaws() + Counter(unknown=int((~known).sum()), thin=int((known & ~used).sum()))
    return Placement(
        match=match,
        middle_level=xy_level.mean(axis=0),
        doubt=doubt_of(match, track, vehicle, used, settings),
        residual_rms_m=float(np.sqrt(((match(xy_level) - xy_world) ** 2).sum(axis=1).mean())),
        frames_used=int(used.sum()),
        left_out={str(reason): count for reason, count in left_out.items() if count},
        contradictions=vehicle.doubts,
    )


def place_jointly(
    own: Passage, others: Sequence[Passage], choice: Choice, settings: Settings
) -> tuple[Placement, tuple[Passage, ...]]:
    """Register the visible outline on the vehicle in all frames at once.

    Other senders' vehicles are registered as well, and used where they agree.

    Parameters
    ----------
    own : Passage
        Of the sender that was chosen, as placed by its boxes.
    others : sequence of Passage
        Of other senders in the same recording.
    choice : Choice
    settings : Settings

    Returns
    -------
    placement : Placement
    passages : tuple of Passage
        Those that were used, the most informative one first.

    Raises
    ------
    MatchError
        If too few frames show anything of the outline, or if an end of the vehicle was never seen and something else
        moves there.
    OpenError
        If the drives leave a direction open.
    """
    drive = evidence_of(own.track, own.vehicle, own.ground.height_m)
    fit = fit_jointly([drive], own.match, [own.time_offset_s], settings.joint)
    if choice.beside and (missing_m := _missing_m(drive, fit.match, fit.time_offsets_s[0])):
        lacks = _lacks(missing_m, own.vehicle)
        raise MatchError(f"{_besides(choice.beside)}, and {lacks}: which of them is the vehicle cannot be told")
    _check_registered(fit, [drive], settings)
    doubts = []
    if apart := compare_halves(own, fit, settings):
        fit = with_doubt(fit, apart)
        doubts.append(str(apart))
    registered, remarks, contradicting = _registered(own, drive, fit, others, settings)
    doubts += contradicting
    seen, drives, alone = zip(*registered, strict=True)
    try:
        together = fit_together(seen, drives, alone, settings.joint)
    except CombineError as error:
        doubts.append(f"only {own.name} was used: {error}{''.join(_late(own, other) for other in seen[1:])}")
        together = fit_together([own], [drive], [fit], settings.joint)
    passages = together.passages
    names = [each.name for each in passages] if len(passages) > 1 else [""]
    placement = place(together.fit, together.drives, together.sightings, settings, names)
    remarks += map(str, together.left_out)
    for each in passages[1:]:
        remarks.append(f"{each.name} is seen as well, and was used: {len(each.track.sightings)} frames")
        remarks += [f"{each.name}: {remark}" for remark in each.vehicle.remarks]
    told = replace(
        placement,
        remarks=(*placement.remarks, *remarks),
        contradictions=(*placement.contradictions, *doubts),
    )
    return told, passages


def _registered(
    own: Passage, drive: Evidence, fit: JointFit, others: Sequence[Passage], settings: Settings
) -> tuple[list[tuple[Passage, Evidence, JointFit]], list[str], list[str]]:
    """Register other senders' outlines as well.

    Returns
    -------
    registered : list of tuple of Passage, Evidence and JointFit
        Those that can be used, including the first one.
    remarks, doubts : list of str
        Why the others cannot be used. A sender whose messages contradict its own points yields a remark if it places
        the sensor where the usable ones place it, or if these are a majority against it. Otherwise it is an objection,
        since the error may be the sensor's clock, and the first sender's placement wrong with it.
    """
    registered, contradicted, remarks, doubts = [(own, drive, fit)], [], [], []
    for other in others:
        try:
            its_drive, alone = _as_well(other, fit, other.time_offset_s - own.time_offset_s, settings)
        except MatchError as error:
            remarks.append(f"{_unused(other)}: {error}")
            continue
        if wrong := _contradicted(alone, [its_drive], [""], missing := _missing(alone, [its_drive])):
            alone = _with_doubt_along(alone, [its_drive], _all_lack_m(missing))
            contradicted.append((other, alone, "; ".join(words for _, words in wrong)))
        else:
            registered.append((other, its_drive, alone))
    used, _, fits = zip(*registered, strict=True)
    for other, alone, wrong_words in contradicted:
        try:
            agreeing([each.name for each in (*used, other)], [*fits, alone])
        except CombineError as error:
            doubts.append(f"{_unused(other)}: {wrong_words}; {error}")
        else:
            remarks.append(f"{_unused(other)}: {wrong_words}")
    return registered, remarks, doubts


def _unused(other: Passage) -> str:
    return f"{other.name} is seen as well, but was not used"


def _as_well(other: Passage, fit: JointFit, late_s: float, settings: Settings) -> tuple[Evidence, JointFit]:
    """Register another sender's outline, given the first one's; a direction that it leaves open does no harm.

    The search begins with a clock offset that is larger by ``late_s``.

    Raises
    ------
    MatchError
        If hardly anything of it is seen where it must be.
    """
    drive = evidence_of(other.track, other.vehicle, other.ground.height_m)
    alone = fit_jointly([drive.thinned(HELD_ROWS)], fit.match, [fit.time_offsets_s[0] + late_s], settings.joint)
    _check_registered(alone, [drive], settings)
    return drive, alone


def _late(own: Passage, other: Passage) -> str:
    """Return in words how much earlier or later than by its messages another vehicle is seen; empty if neither."""
    late_s = other.time_offset_s - own.time_offset_s
    if late_s == 0.0:
        return ""
    when = "before" if late_s > 0.0 else "after"
    return f"; {other.name} is seen {abs(late_s):.2f} s {when} its messages have it there, as by a wrong clock"


def place(
    fit: JointFit, drives: Sequence[Evidence], sightings: int, settings: Settings, names: Sequence[str] = ("",)
) -> Placement:
    """Return a joint fit with its uncertainty, and with what in the messages contradicts it.

    Parameters
    ----------
    fit : JointFit
    drives : sequence of Evidence
        Those of the fit.
    sightings : int
        Number of frames of all drives in which the vehicle was seen.
    settings : Settings
    names : sequence of str
        Names of the drives, for messages.

    Raises
    ------
    MatchError
        If too few frames show anything of the outline, or if it explains too few of the points.
    OpenError
        If the drives leave a direction open.
    """
    _check_registered(fit, drives, settings)
    middles = np.concatenate([drive.middles for drive in drives])
    doubt = Doubt(fit.covariance, rotate_xy(fit.match.yaw_rad, middles - fit.centre_level))
    weakest_m, _ = doubt.weakest
    most_m = max(settings.quality.open_m, 3.0 * min(_told(drive.vehicle) for drive in drives))
    if weakest_m > most_m:
        raise OpenError(
            f"the position along the weakest direction is known to {weakest_m:.2f} m; needed are {most_m:.2f} m: "
            f"{_advice(fit, doubt, drives[0])}"
        )
    missing, longer = _missing(fit, drives), [_longer_m(drive) for drive in drives]
    fit = _with_doubt_along(fit, drives, _all_lack_m(missing))
    fit = _with_doubt_along(fit, drives, min(map(_shift_m, drives, longer)))
    covariance = fit.covariance.copy()
    covariance[1:, 1:] += fit.covariance_by_optics(middles)
    doubt = Doubt(covariance, doubt.arms)
    known = sum(
        int(drive.vehicle.at(drive.stamps_s + offset_s)[2].sum())
        for drive, offset_s in zip(drives, fit.time_offsets_s, strict=True)
    )
    bare = max(0, known - fit.standing - fit.frames)
    left_out = {"unknown": sightings - known, "standing": fit.standing, "bare": bare}
    contradicted = _contradicted(fit, drives, names, missing)
    for name, drive, longer_m in zip(names, drives, longer, strict=True):
        contradicted += [(name, words) for words in _too_long(drive, longer_m)]
    apart, unexpected = _apart_in_words(fit), fit.settings.apart_sigma_s > settings.joint.apart_sigma_s
    return Placement(
        match=fit.match,
        middle_level=fit.centre_level,
        doubt=doubt,
        residual_rms_m=fit.residual_rms_m,
        frames_used=fit.frames,
        left_out={reason: count for reason, count in left_out.items() if count},
        time_offset_s=fit.time_offsets_s[0],
        time_sigma_s=fit.time_sigmas_s[0],
        turn=fit.turn,
        nearer=fit.nearer,
        remarks=(
            *([_turning(fit, turn_s)] if (turn_s := max(drive.turn_s for drive in drives)) else []),
            *(apart if not unexpected else []),
            *_assumed_accuracies(drives, names, settings.joint),
        ),
        advice=_advice(fit, doubt, drives[0], _all_lack_m(missing)),
        contradictions=(
            *(f"{name}: {words}" if name else words for name, words in contradicted),
            *([_optics_in_words(fit)] if fit.optics else []),
            *(f"{words}; trigger both cameras at once" for words in apart if unexpected),
            *([_perhaps_unset(fit.perhaps_unset, fit)] if fit.perhaps_unset else []),
        ),
        bodies=fit.bodies,
    )


def _check_registered(fit: JointFit, drives: Sequence[Evidence], settings: Settings) -> None:
    if fit.frames < settings.match.min_frames:
        raise MatchError(
            f"the vehicle's outline is seen in {fit.frames} frames while its CAMs report its position; needed are "
            f"{settings.match.min_frames}{_blurred(drives)}"
        )
    if fit.explained < LEAST_EXPLAINED:
        raise MatchError(
            f"the outline that the messages report explains {fit.explained:.0%} of the vehicle's points; needed are "
            f"{LEAST_EXPLAINED:.0%}: something else is seen with it, or its messages are wrong"
        )


def _contradicted(
    fit: JointFit, drives: Sequence[Evidence], names: Sequence[str], missing: Sequence[Mapping[str, float]]
) -> list[tuple[str, str]]:
    """Return in words what the points contradict in the messages or in the vehicle, each with its drive's name."""
    found = []
    for name, drive, corrections, missing_m in zip(names, drives, fit.corrections, missing, strict=True):
        wrong = (_in_words(each, drive.vehicle) for each in _wrong(corrections))
        found += [(name, words) for words in (*wrong, *drive.vehicle.doubts)]
        if missing_m:
            found.append((name, f"{_lacks(missing_m, drive.vehicle)}: {ANOTHER_PIECE}"))
    return found


def doubts_of(choice: Choice) -> tuple[str, ...]:
    """Return the objections to the choice of the vehicle."""
    doubts = [doubt for doubt in (choice.clocks, choice.doubt) if doubt]
    if choice.beside:
        doubts.append(_part_of_it(choice.beside))
    return tuple(doubts)


def ridden_doubts(
    choice: Choice, passages: Sequence[Passage], tracks: Sequence[Track], placement: Placement
) -> tuple[str, ...]:
    """Return objections where something moves along with a vehicle, unless `choice` has it; see `ridden_frames`."""
    told = []
    for each, frames in zip(passages, ridden_frames(passages, tracks, placement.match), strict=True):
        if frames and not (choice.beside and each.station_id == choice.station):
            told.append(f"{each.name}: {_part_of_it(frames)}" if len(passages) > 1 else _part_of_it(frames))
    return tuple(told)


def _part_of_it(frames: int) -> str:
    return (
        f"{_besides(frames)}: a trailer that its messages do not report, or a piece of it, may have been taken for the "
        "vehicle"
    )


def _besides(frames: int) -> str:
    return f"something else moves with the vehicle, right behind or ahead of it, in {frames} frames"


def _missing_m(drive: Evidence, match: PlanarMatch, time_offset_s: float) -> dict[str, float]:
    """Return the length of each end of the vehicle that was never seen, by the end's name."""
    least_m = LEAST_UNSEEN_M + 3.0 * drive.vehicle.guessed_m[0]
    ends_m = dict(zip(("rear", "front"), unseen_m(drive, match, time_offset_s), strict=True))
    return {end: end_m for end, end_m in ends_m.items() if end_m > least_m}


def _lacks(missing_m: Mapping[str, float], vehicle: VehicleTrack) -> str:
    """Return in words which end of a vehicle was never seen."""
    ends = " and ".join(f"the {end} {end_m:.1f} m" for end, end_m in missing_m.items())
    return f"{ends} of the vehicle's {vehicle.length_m:.1f} m were never seen, although its side was"


def _longer_m(drive: Evidence) -> float:
    """Return by how much a detector's boxes are longer than the vehicle by its messages; 0 where that is no surprise.

    One box's error of length counts as the error that all share, in addition to that of what the messages report.
    """
    if len(drive.points) or not len(drive):
        return 0.0
    longer_m = -drive.lacking_m[:, 0]
    median_m = float(np.median(longer_m))
    scatter_m = NORMAL * float(np.median(np.abs(longer_m - median_m)))
    sigma_m = math.hypot(scatter_m, JointSettings.size_sigma_m, drive.vehicle.guessed_m[0])
    return median_m if median_m > CONTRADICTED * sigma_m else 0.0


def _shift_m(drive: Evidence, longer_m: float) -> float:
    """Return by how much a vehicle's middle shifts, relative to its reported position, if it is longer by so much."""
    return abs(drive.vehicle.reference[0]) / drive.vehicle.length_m * longer_m


def _too_long(drive: Evidence, longer_m: float) -> list[str]:
    """Return in words that a detector's boxes are longer than the vehicle by its messages, if they are."""
    if longer_m == 0.0:
        return []
    length_m = drive.vehicle.length_m
    told = "was assumed" if drive.vehicle.guessed_m[0] else "its messages report"
    words = (
        f"the vehicle's boxes are {length_m + longer_m:.1f} m long in the median, and {told} {length_m:.1f} m: if the "
        f"boxes are right, the position is off by {_shift_m(drive, longer_m):.2f} m along the drive"
    )
    return [words]


def _with_doubt_along(fit: JointFit, drives: Sequence[Evidence], off_m: float) -> JointFit:
    """Return a fit with the uncertainty along its vehicles of being off by ``off_m`` with a probability of one half.

    So it is where what was seen is perhaps another part of the vehicle, by the length that was never seen.
    """
    poses = [drive.vehicle.at(drive.stamps_s + s) for drive, s in zip(drives, fit.time_offsets_s, strict=True)]
    yaw = np.concatenate([yaw[known] for _, yaw, known in poses])
    along = np.stack([np.cos(yaw), np.sin(yaw)])
    covariance = fit.covariance.copy()
    covariance[1:, 1:] += off_m**2 / 2.0 * (along @ along.T) / max(len(yaw), 1)
    return replace(fit, covariance=covariance)


def _all_lack_m(missing: Sequence[Mapping[str, float]]) -> float:
    """Return the least unseen length of all drives: a complete vehicle determines where the others' parts are."""
    return min(max(each.values(), default=0.0) for each in missing)


def _missing(fit: JointFit, drives: Sequence[Evidence]) -> list[dict[str, float]]:
    """Return the result of `_missing_m` for each drive.

    It is empty where the messages' positions are those of another place along the vehicle, since that place explains
    what seems to be missing.
    """
    elsewhere = (any(each.what == "ahead" for each in _wrong(corrections)) for corrections in fit.corrections)
    return [
        {} if is_elsewhere else _missing_m(drive, fit.match, offset_s)
        for drive, offset_s, is_elsewhere in zip(drives, fit.time_offsets_s, elsewhere, strict=True)
    ]


def _wrong(corrections: Iterable[Correction]) -> list[Correction]:
    """Return the corrections that contradict the messages."""
    return [each for each in corrections if each.surprise > CONTRADICTED]


def _in_words(correction: Correction, vehicle: VehicleTrack) -> str:
    """Return in words what the points contradict in the messages, or in what was assumed where they report nothing."""
    value, sigma = correction.value, correction.sigma
    if correction.what == "clock":
        return f"the clocks are {1e3 * value:.0f} ms apart, where {1e3 * sigma:.0f} ms were expected: --clock unknown"
    if correction.what == "heading":
        return f"the messages' heading is {np.degrees(value):.1f} deg off the vehicle's body, clockwise"
    if correction.what == "lag":
        age = "older" if value > 0 else "newer"
        return f"the messages' headings are {1e3 * abs(value):.0f} ms {age} than their positions"
    if correction.what == "ahead":
        where = f"{abs(value):.2f} m {'behind' if value > 0 else 'ahead of'}"
        return f"the messages' positions are {where} the point that --cam-reference gives"
    if correction.what == "left":
        side = "right" if value > 0 else "left"
        return f"the messages' positions are {abs(value):.2f} m to the {side} of the point that --cam-reference gives"
    guessed_m = dict(zip(("length", "width"), vehicle.guessed_m, strict=True))
    told = "was assumed" if guessed_m[correction.what] else "its messages report"
    return f"the vehicle's {correction.what} is {value:+.2f} m off what {told}"


def _optics_in_words(fit: JointFit) -> str:
    """Return in words what the points contradict in a stereo calibration."""
    shares = [each.value for each in fit.optics]
    off_m = float(np.hypot(*(fit.centre_level * shares)))
    depths, breadths = (
        f"{100.0 * abs(each.value):.1f} +- {100.0 * each.after:.1f} % {'larger' if each.value > 0.0 else 'smaller'}"
        for each in fit.optics
    )
    return (
        f"depths are {depths} than measured, and widths {breadths}: the stereo calibration's focal length (depths "
        f"alone) or baseline (both) is wrong, and the camera's position is off by about {off_m:.1f} m; correct it and "
        "calibrate again; left and right images of different moments look alike"
    )


def _apart_in_words(fit: JointFit) -> list[str]:
    """Return in words how much later than the left images the right ones were taken; none if it was not estimated."""
    if (apart := fit.apart) is None:
        return []
    words = (
        f"by the drive, the right images are {1e3 * abs(apart.value):.1f} +- {1e3 * apart.after:.1f} ms "
        f"{'later' if apart.value > 0.0 else 'earlier'} than the left ones: the result includes it, but whatever moves "
        "is measured at wrong distances"
    )
    if fit.perhaps_optics:
        words += ", or else the stereo calibration's focal length or baseline is wrong"
    return [words]


def _perhaps_unset(clock: Correction, fit: JointFit) -> str:
    """Return in words that an unset clock would explain the points better, or as wrong optics do."""
    fits = "explain it too" if fit.optics else "fit better"
    return (
        f"a clock offset of {1e3 * clock.value:.0f} +- {1e3 * clock.after:.0f} ms would {fits}; unless the clocks are "
        "known to be synchronised: --clock unknown"
    )


def _turning(fit: JointFit, turn_s: float) -> str:
    """Return in words how the scanner rotates, if at all; one revolution takes ``turn_s``."""
    how = {0.0: "all at once", 1.0: "spinning counter-clockwise", -1.0: "spinning clockwise"}[fit.turn]
    found = f"by the drive, the scanner measures a scan's points {how} (probability {fit.turn_probability:.0%})"
    if fit.turn == 0.0:
        return found
    return (
        f"{found}, one revolution in {turn_s:.3g} s; the clock offset then includes the time within the revolution at "
        "which the vehicle is measured, which --sweep removes"
    )


def _assumed_accuracies(drives: Sequence[Evidence], names: Sequence[str], settings: JointSettings) -> list[str]:
    """Return in words the accuracy that was assumed for positions where the messages report none."""
    assumed = (
        f"the messages report no accuracy of their positions: taken as {settings.position_sigma_m:g} m, that of a "
        "receiver with carrier-phase corrections; with another the result is as far off as its positions: "
        "give --cam-sigma"
    )
    return [
        f"{name}: {assumed}" if name else assumed
        for name, drive in zip(names, drives, strict=True)
        if not np.isfinite(drive.vehicle.position_sigma_m)
    ]


def _told(vehicle: VehicleTrack) -> float:
    """Return the standard deviation of positions that the messages report; 0 if they report none."""
    return vehicle.position_sigma_m if np.isfinite(vehicle.position_sigma_m) else 0.0


def _blurred(drives: Sequence[Evidence]) -> str:
    """Return in words that the matching window mixes outline and road; empty if it does not, or without points."""
    blurs_m = np.concatenate([drive.blur_m for drive in drives])
    if not len(blurs_m):  # boxes of a detector
        return ""
    blur_m = float(np.median(blurs_m))
    sides, behind_m = np.arange(outline.SIDES), np.full(outline.SIDES, np.inf)
    highest_m = max(
        float(outline.highest_of(drive.vehicle.width_m, sides, behind_m, matched=True).max()) for drive in drives
    )
    if outline.LOWEST_M + blur_m < highest_m:
        return ""
    return (
        f"; the matcher's window is {2 * blur_m:.1f} m high there, so that the outline below {highest_m:.2f} m cannot "
        "be told from the road: record it nearer, or with more pixels"
    )


def _advice(fit: JointFit, doubt: Doubt, drive: Evidence, missing_m: float = 0.0) -> str:
    """Return in words where the result is weakest, why, and what would improve it."""
    sigma_m, yaw = doubt.weakest
    velocity = _velocity(drive, fit.time_offsets_s[0])
    by_clock = float(np.hypot(*velocity)) * fit.time_sigmas_s[0]
    by_yaw = doubt.yaw_rad * float(np.sqrt((doubt.arms**2).sum(axis=1).mean()))
    along = abs(np.cos(yaw - np.arctan2(velocity[1], velocity[0]))) > np.sqrt(0.5)
    direction = "along the drive" if along else "across the drive"
    if along and missing_m > sigma_m:  # 0.7 of it is in the uncertainty
        why = "an end of the vehicle was never seen: the result may be shifted by as much; another vehicle shows both"
    elif along and by_clock > 0.7 * sigma_m:
        why = (
            f"the clock offset, known to {1e3 * fit.time_sigmas_s[0]:.0f} ms, cannot be told from a shift; a turn, or "
            "braking while in view, separates them"
        )
    elif _told(drive.vehicle) > 0.7 * sigma_m:
        why = f"the CAMs' own positions are known to {_told(drive.vehicle):.2f} m; drives at other times average that"
    elif by_yaw > 0.7 * sigma_m:
        why = "the drive is short, so its direction is uncertain; a longer one determines the yaw"
    else:
        why = "few sides of the vehicle are seen; a drive that turns, or comes back the other way, shows the others"
    return f"weakest {direction} ({sigma_m:.2f} m): {why}"


def _velocity(drive: Evidence, offset_s: float) -> FloatArray:
    """Return the mean velocity in the world frame, shape (2,), m/s."""
    xy, _, known = drive.vehicle.at(drive.stamps_s + offset_s)
    ends = np.flatnonzero(known)[[0, -1]]
    passed = max(float(np.diff(drive.stamps_s[ends])[0]), 1e-3)
    mean: FloatArray = (xy[ends[1]] - xy[ends[0]]) / passed
    return mean
