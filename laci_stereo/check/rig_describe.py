"""Report of a stereo calibration and its fit to the images, as text and as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from laci_stereo.check.rig_images import RigCheck
from laci_stereo.check.rig_parallax import FLOOR_PX
from laci_stereo.check.rig_verdict import Fit
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.result.calibration_file import Document
from laci_stereo.io.rig.stereo_rig import Lens, StereoRig
from laci_stereo.stereo.rectify import undistorted

DISTANCES_M = (10.0, 20.0, 40.0, 80.0)


def describe_rig(files: Sequence[Path], check: RigCheck) -> str:
    """Return a text: the calibration as it was read, its fit to the images, and the verdict."""
    rig, (width, height) = check.rig, check.size
    lines = [
        ("Rig", " + ".join(map(str, files))),
        *(("Note", note) for note in rig.notes),
        ("Left", _lens_text(rig.left)),
        ("Right", _lens_text(rig.right)),
        ("Baseline", _baseline_text(rig)),
        ("Images", f"{width} x {height} pixels"),
        *(_fit_lines(check.fit) if check.fit is not None else ()),
        *(("Skipped", line) for line in check.skipped),
        ("Verdict", check.outcome.upper()),
        *((f"  {finding.outcome}", finding.text) for finding in check.findings),
    ]
    return "\n".join(f"{name:<11}{text}" for name, text in lines)


def rig_document(files: Sequence[Path], check: RigCheck) -> Document:
    """Return the result of a check as a JSON document."""
    rig = check.rig
    return {
        "files": [str(file) for file in files],
        "notes": list(rig.notes),
        "left": _lens_document(rig.left),
        "right": _lens_document(rig.right),
        "baseline_m": rig.baseline_m,
        "R_right_left": rig.R_right_left.tolist(),
        "t_right_left_m": rig.t_right_left_m.tolist(),
        "image_size": list(check.size),
        "fit": None if check.fit is None else _fit_document(check.fit),
        "skipped": list(check.skipped),
        "verdict": check.outcome,
        "reasons": [finding.text for finding in check.findings],
    }


def field_of_view_deg(lens: Lens) -> tuple[float, float]:
    """Return the angles between the viewing directions at the middles of opposite borders, horizontal and vertical."""
    (width, height), (cx, cy) = lens.size, lens.K[:2, 2]
    ends = np.array([[0.0, cy], [width - 1.0, cy], [cx, 0.0], [cx, height - 1.0]])
    angles = np.degrees(np.arctan(undistorted(lens, ends)))
    return float(angles[1, 0] - angles[0, 0]), float(angles[3, 1] - angles[2, 1])


def depth_sigma_m(fit: Fit, noise_px: float, distance_m: float) -> float:
    """Return the standard deviation of a depth Z, from that of the disparity times Z^2 / (f b)."""
    sigma_px = float(np.hypot(noise_px, FLOOR_PX))
    return distance_m**2 * sigma_px / (fit.points.focal_px * fit.points.baseline_m)


def _lens_text(lens: Lens) -> str:
    across, down = field_of_view_deg(lens)
    used = int(np.count_nonzero(lens.distortion))
    model = f"{lens.model}, {len(lens.distortion)} coefficients" if used else f"{lens.model}, no distortion"
    return (
        f"{lens.size[0]} x {lens.size[1]} pixels, focal length {lens.K[0, 0]:.1f}, {lens.K[1, 1]:.1f} px, "
        f"centre {lens.K[0, 2]:.1f}, {lens.K[1, 2]:.1f}, sees {across:.1f} x {down:.1f} deg; {model}"
    )


def _baseline_text(rig: StereoRig) -> str:
    turn_deg = np.degrees(cv2.Rodrigues(rig.R_right_left)[0].ravel())
    second = -rig.R_right_left.T @ rig.t_right_left_m
    side = "right" if second[0] > 0 else "left"
    return (
        f"{rig.baseline_m:.4f} m; the second camera stands on the {side} of the first, turned by "
        f"{', '.join(f'{angle:+.2f}' for angle in turn_deg)} deg about x, y, z"
    )


def _fit_lines(fit: Fit) -> Iterator[tuple[str, str]]:
    yield "Matches", f"{len(fit.points)} in {fit.pairs - fit.strange} of {fit.pairs} pairs"
    parallax = fit.parallax
    if parallax is None:
        return
    middle, across, down = parallax.trend_px
    spread = f"median {parallax.median_px:+.2f} px, 95 % within {parallax.high_px:.2f} px"
    yield "Parallax", f"{spread}; noise {parallax.noise_px:.2f} px, systematic {parallax.systematic_px:.2f} px"
    yield "Trend", f"{middle:+.2f} px in the middle, {across:+.2f} px across the image, {down:+.2f} px down it"
    turns = zip(np.degrees(parallax.turn.angles_rad), np.degrees(parallax.turn.sigma_rad), strict=True)
    yield (
        "Turn",
        "right camera against the calibration, about x, y, z: "
        + ", ".join(f"{angle:+.3f} +- {sigma:.3f}" for angle, sigma in turns)
        + " deg",
    )
    unseen = 3 * parallax.turn.sigma_rad[1]
    blind = f"a yaw below {np.degrees(unseen):.2f} deg, {fit.points.focal_px * unseen:.1f} px of disparity"
    yield "Unseen", f"{blind}: it hardly moves points off their rows"
    low, high = np.percentile(fit.points.disparity_px, [1, 99])
    yield "Disparity", f"{low:.1f} to {high:.1f} px"
    depths = ", ".join(
        f"{depth_sigma_m(fit, parallax.noise_px, distance):.2f} m at {distance:g} m" for distance in DISTANCES_M
    )
    yield "Depth", f"one sigma {depths} (of {np.hypot(parallax.noise_px, FLOOR_PX):.2f} px disparity)"
    if fit.lag is not None:
        lag_ms = f"{1000 * fit.lag.seconds:+.1f} +- {1000 * fit.lag.sigma_s:.1f} ms"
        yield "Times", f"right images {lag_ms} later than left ones, by {fit.lag.count} points that move"


def _lens_document(lens: Lens) -> Document:
    return {
        "model": lens.model,
        "size": list(lens.size),
        "K": lens.K.tolist(),
        "distortion": lens.distortion.tolist(),
        "field_of_view_deg": list(field_of_view_deg(lens)),
    }


def _fit_document(fit: Fit) -> Document:
    parallax = fit.parallax
    counts: Document = {"pairs": fit.pairs, "pairs_without_common_scene": fit.strange, "matches": len(fit.points)}
    if parallax is None:
        return counts
    sigmas = {f"{each:g}": depth_sigma_m(fit, parallax.noise_px, each) for each in DISTANCES_M}
    lag = fit.lag
    return {
        **counts,
        "parallax_median_px": parallax.median_px,
        "parallax_95_px": parallax.high_px,
        "noise_px": parallax.noise_px,
        "systematic_px": parallax.systematic_px,
        "trend_px": list(parallax.trend_px),
        "turn_deg": _degrees(parallax.turn.angles_rad),
        "turn_sigma_deg": _degrees(parallax.turn.sigma_rad),
        "depth_sigma_m": sigmas,
        "lag_s": None if lag is None else lag.seconds,
        "lag_sigma_s": None if lag is None else lag.sigma_s,
    }


def _degrees(angles_rad: FloatArray) -> list[float]:
    degrees: list[float] = np.degrees(angles_rad).tolist()
    return degrees
