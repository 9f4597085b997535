"""Report of a lane check, as text and as JSON."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from laci_stereo.check.fit import PlanarError
from laci_stereo.check.lanes import LaneCheck, LineCheck
from laci_stereo.io.result.calibration_file import Document


def check_document(check: LaneCheck, map_sigma_m: float) -> Document:
    """Return the result of a check in the form that ``calibration.json`` uses."""
    return {
        "verdict": check.judgement.outcome,
        "reasons": list(check.judgement.reasons),
        "lines_in_view": check.lines_sought,
        "lines_found": check.lines_found,
        "residual_m": check.residual_m,
        "residual_px": check.residual_px,
        "map_sigma_m": map_sigma_m,
        "error": None if check.error is None else _error_document(check.error),
        "lines": [
            {
                "id": line.id,
                "kind": line.kind,
                "in_view_m": line.in_view_m,
                "hidden_m": line.hidden_m,
                "found_m": line.found_m,
                "found": line.found,
                "astray": line.astray,
                "offset_m": line.offset_m,
                "sigma_m": line.sigma_m,
                "offset_px": line.offset_px,
                "sigma_px": line.sigma_px,
            }
            for line in check.lines
        ],
    }


def _error_document(error: PlanarError) -> Document:
    return {
        "east_m": float(error.value[0]),
        "north_m": float(error.value[1]),
        "turn_deg": float(np.degrees(error.value[2])),
        "centre_world": error.centre.tolist(),
        "covariance": error.covariance.tolist(),
        "chi_square": error.chi_square,
    }


def describe_check(check: LaneCheck) -> str:
    """Return a text: a table of the lines, the results of all lines together, and the verdict."""
    return "\n".join([*_table(check.lines), *_together(check), f"{'Verdict':<11}{verdict_text(check)}"])


def check_line(check: LaneCheck) -> str:
    """Return a summary in one line."""
    residual = "" if check.residual_m is None else f", {100 * check.residual_m:.0f} cm off on the ground"
    pixels = "" if check.residual_px is None else f", {check.residual_px:.1f} px"
    return (
        f"{check.lines_found} of {check.lines_sought} lines of the map found{residual}{pixels}; {verdict_text(check)}"
    )


def verdict_text(check: LaneCheck) -> str:
    """Return the verdict and its reasons in one line."""
    return ": ".join(filter(None, [check.judgement.outcome.upper(), "; ".join(check.judgement.reasons)]))


def _table(lines: tuple[LineCheck, ...]) -> Iterator[str]:
    if not lines:
        return
    yield f"{'line':<12}{'kind':<14}{'in view':>9}{'found':>8}{'offset [cm]':>17}{'[px]':>14}"
    for line in lines:
        found = "astray" if line.astray else "" if line.found else "too little"
        length = f"{line.in_view_m:>7.0f} m{line.found_m:>6.0f} m"
        yield f"{line.id[-11:]:<12}{line.kind[:13]:<14}{length}{_offsets(line)}  {found}".rstrip()


def _offsets(line: LineCheck) -> str:
    if line.offset_m is None or line.sigma_m is None:
        return f"{'-':>17}{'-':>14}"
    metres = f"{100 * line.offset_m:+.1f} +- {100 * line.sigma_m:.1f}"
    pixels = "-" if line.offset_px is None else f"{line.offset_px:+.1f} +- {line.sigma_px:.1f}"
    return f"{metres:>17}{pixels:>14}"


def _together(check: LaneCheck) -> Iterator[str]:
    yield f"{'Lines':<11}{check.lines_found} of {check.lines_sought} in view found"
    if check.residual_m is not None:
        pixels = "" if check.residual_px is None else f", {check.residual_px:.1f} px"
        yield f"{'Residual':<11}{100 * check.residual_m:.1f} cm on the ground{pixels} (root mean square)"
    if check.error is not None:
        yield f"{'Off by':<11}{error_text(check.error)}"


def error_text(error: PlanarError) -> str:
    """Return the planar error of a calibration as text."""
    sigma = np.sqrt(np.diag(error.covariance))
    return (
        f"{100 * error.value[0]:+.1f} +- {100 * sigma[0]:.1f} cm east, {100 * error.value[1]:+.1f} +- "
        f"{100 * sigma[1]:.1f} cm north, {np.degrees(error.value[2]):+.3f} +- {np.degrees(sigma[2]):.3f} deg "
        "counter-clockwise (the map's own error is in the doubt)"
    )
