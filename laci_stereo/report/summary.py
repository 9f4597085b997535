"""The summary of a calibration in the terminal: about ten lines of text."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.result import Calibration, Quality

LEFT_OUT = {
    "cut": "cut by the border of the field of view",
    "far": "too far away",
    "thin": "too thin",
    "unknown": "without CAMs that report where it is",
    "bare": "without a point of the outline",
    "standing": "stationary where it is seen in others",
}


def summarise(calibration: Calibration, sensor: str, inputs: str) -> str:
    """Describe the sensor's pose, the data that it was estimated from, its uncertainty and the verdict.

    Parameters
    ----------
    calibration : Calibration
    sensor : str
        Name and frame of the sensor, in words.
    inputs : str
        Description of the input files.
    """
    world, quality = calibration.world, calibration.quality
    position = calibration.T_world_sensor[:3, 3]
    east, north = world.to_utm(position[None, :2])[0]
    latitude, longitude = world.to_geodetic(position[None, :2])[0]
    angles, drive = calibration.viewing_angles, calibration.drive
    place = f"{east:.2f} m E, {north:.2f} m N ({world.crs}); latitude {latitude:.7f}, longitude {longitude:.7f}"
    looks = (
        f"{angles.yaw_deg:.2f} deg counter-clockwise from grid east, {angles.down_deg:.2f} deg down, "
        f"rolled {angles.roll_deg:.2f} deg clockwise"
    )
    size = f"{drive.vehicle.length_m:.2f} m x {drive.vehicle.width_m:.2f} m"
    told = all(np.isfinite(passage.vehicle.position_sigma_m) for passage in calibration.passages)
    one_sigma = "one sigma" if told else "one sigma, if positions are as exact as assumed"
    doubt = (
        f"{quality.track_xy_sigma_m:.2f} m along the track, {quality.yaw_sigma_deg:.2f} deg yaw, "
        f"{quality.tilt_sigma_deg:.2f} deg tilt, {quality.height_sigma_m:.3f} m height ({one_sigma})"
    )
    static = drive.background
    lines = [
        ("Sensor", sensor),
        ("Position", place),
        ("Height", f"{calibration.height_m:.2f} m above the ground{_slope(calibration)}"),
        ("Looks", looks),
        ("Vehicle", f"station {drive.station_id}, {size}{others_of(calibration)}, {_frames(quality)}"),
        ("Background", f"{len(static.boxes)} boxes, from {static.quiet_frames} frames at rest"),
        ("Fit", _fit(calibration)),
        ("Doubt", "; ".join(filter(None, [doubt, quality.advice]))),
        ("Input", inputs),
        ("Verdict", ": ".join([quality.verdict.upper(), "; ".join(quality.reasons)]).rstrip(": ")),
    ]
    return "\n".join(f"{name:<11}{text}" for name, text in lines)


def _slope(calibration: Calibration) -> str:
    if calibration.slope is None or not calibration.slope.steepness:
        return ""
    x, y = calibration.slope.gradient
    towards = np.degrees(np.arctan2(y, x))
    return f", which rises by {100 * np.hypot(x, y):.1f} % towards {towards:.0f} deg counter-clockwise from grid east"


def _fit(calibration: Calibration) -> str:
    rms_m = calibration.quality.residual_rms_m
    if calibration.drive.method == "paper":
        return f"paper's method; the vehicle's tracks in sensor and world are {rms_m:.2f} m apart (RMS)"
    clock = f"clock offset {1e3 * calibration.drive.time_offset_s:.1f} +- {1e3 * calibration.time_sigma_s:.1f} ms"
    differs = calibration.paper_differs
    beside = "has no answer" if differs is None else f"would place objects {differs[0]:.2f} m, {differs[1]:.2f} deg off"
    return f"points are {rms_m:.2f} m from the vehicle's outline (RMS); {clock}; the paper's method {beside}"


def others_of(calibration: Calibration) -> str:
    """Return the number and the stations of the other drives that the result was estimated from, in words."""
    if not calibration.others:
        return ""
    stations = ", ".join(str(station) for station in sorted({other.station_id for other in calibration.others}))
    more = len(calibration.others)
    return f", and {more} more drive{'s' if more > 1 else ''} (station {stations})"


def _frames(quality: Quality) -> str:
    left_out = ", ".join(f"{count} {LEFT_OUT[reason]}" for reason, count in sorted(quality.left_out.items()))
    used = f"{quality.frames_used} of {quality.frames_seen} frames used"
    return f"{used} ({left_out})" if left_out else used
