"""What a joint fit finds beside the pose, in words: what contradicts the messages or the sensor, and remarks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from laci_stereo.core.estimation.drive_prior import Correction
from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.estimation.joint import JointFit
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.placement.seen_length import SeenLength
from laci_stereo.core.settings import JointSettings


def against_messages(
    fit: JointFit, drives: Sequence[Evidence], lengths: Sequence[SeenLength], names: Sequence[str]
) -> list[str]:
    """Return what the points contradict in the messages or in the vehicle; a drive that has a name is named.

    Parameters
    ----------
    fit : JointFit
    drives : sequence of Evidence
        Those of the fit.
    lengths : sequence of SeenLength
        What was seen of each drive's vehicle.
    names : sequence of str
    """
    found = []
    for name, drive, corrections, length in zip(names, drives, fit.corrections, lengths, strict=True):
        wrong = [_in_words(each, drive.vehicle) for each in corrections if each.contradicts]
        found += _named(name, (*wrong, *drive.vehicle.objections, *length.objections))
    return found


def against_sensor(fit: JointFit, settings: JointSettings) -> list[str]:
    """Return what the drives contradict in the stereo calibration, the cameras' trigger or the sensor's clock.

    Parameters
    ----------
    fit : JointFit
    settings : JointSettings
        What was stated about the sensor.
    """
    found = []
    if fit.optics:
        found.append(_optics(fit))
    if fit.apart and _unexpectedly_apart(fit, settings):
        found.append(f"{_apart(fit, fit.apart)}; trigger both cameras at once")
    if fit.perhaps_unset:
        by_sensor = bool(fit.optics) or _unexpectedly_apart(fit, settings)
        found.append(_perhaps_unset(fit.perhaps_unset, by_sensor=by_sensor))
    return found


def remarks_on(fit: JointFit, drives: Sequence[Evidence], names: Sequence[str], settings: JointSettings) -> list[str]:
    """Return what was found out about the sensor as expected, and what had to be assumed about the messages.

    Parameters are those of `against_messages` and `against_sensor`.
    """
    found = []
    if turn_s := max(drive.turn_s for drive in drives):
        found.append(_turning(fit, turn_s))
    if fit.apart and not _unexpectedly_apart(fit, settings):
        found.append(_apart(fit, fit.apart))
    assumed = (
        f"the messages report no accuracy of their positions: taken as {settings.position_sigma_m:g} m, that of a "
        "receiver with carrier-phase corrections; with another the result is as far off as its positions: "
        "give --cam-sigma"
    )
    silent = [
        name for name, drive in zip(names, drives, strict=True) if not np.isfinite(drive.vehicle.position_sigma_m)
    ]
    if silent:
        found += _named("" if len(silent) == len(drives) else ", ".join(silent), [assumed])
    return found


def _named(name: str, found: Sequence[str]) -> list[str]:
    return [f"{name}: {words}" for words in found] if name else list(found)


def _unexpectedly_apart(fit: JointFit, settings: JointSettings) -> bool:
    """Tell whether left and right images are of different moments although they were said to be of one."""
    return fit.settings.apart_sigma_s > settings.apart_sigma_s


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


def _optics(fit: JointFit) -> str:
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


def _apart(fit: JointFit, apart: Correction) -> str:
    """Return in words how much later than the left images the right ones were taken."""
    words = (
        f"by the drive, the right images are {1e3 * abs(apart.value):.1f} +- {1e3 * apart.after:.1f} ms "
        f"{'later' if apart.value > 0.0 else 'earlier'} than the left ones: the result includes it, but whatever moves "
        "is measured at wrong distances"
    )
    return (
        f"{words}, or else the stereo calibration's focal length or baseline is wrong" if fit.perhaps_optics else words
    )


def _perhaps_unset(clock: Correction, *, by_sensor: bool) -> str:
    """Return in words that an unset clock would explain the points better, or as well as an error of the sensor."""
    fits = "explain it too" if by_sensor else "fit better"
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
