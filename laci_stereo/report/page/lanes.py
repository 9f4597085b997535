"""The result of the lane check, for the page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from laci_stereo.io.result.calibration_file import Document
from laci_stereo.report.page.facts import Fact, signed


@dataclass(frozen=True)
class LineFacts:
    """The check of one line of the map, in words."""

    id: str
    kind: str
    in_view: str
    found: str
    offset_cm: str
    offset_px: str
    remark: str


@dataclass(frozen=True)
class LaneFacts:
    """The lane check, in words; ``look`` is a class of the style sheet, "pass", "fail" or "warn"."""

    look: str
    sentence: str
    reasons: tuple[str, ...]
    facts: tuple[Fact, ...]
    lines: tuple[LineFacts, ...]


_SENTENCES = {
    "pass": "Yes: the map's lines lie on the road's, and an error of 30 cm or 0.5° is ruled out.",
    "fail": "No: the map's lines do not lie on the road's.",
    "cannot tell": "The lines cannot tell.",
}


def lane_facts(check: Document | None) -> LaneFacts | None:
    """Describe a lane check in words; None where there was none."""
    if check is None:
        return None
    return LaneFacts(
        look={"pass": "pass", "fail": "fail"}.get(check["verdict"], "warn"),
        sentence=_SENTENCES[check["verdict"]],
        reasons=tuple(reason[:1].upper() + reason[1:] for reason in check["reasons"]),
        facts=tuple(_facts(check)),
        lines=tuple(_line(line) for line in check["lines"]),
    )


def _facts(check: Document) -> Iterator[Fact]:
    found = f"{check['lines_found']} of {check['lines_in_view']}"
    yield Fact("Lines found", found, "of the map's lines that are in view")
    if check["residual_m"] is not None:
        pixels = "" if check["residual_px"] is None else f", {check['residual_px']:.1f} px"
        residual = f"{100 * check['residual_m']:.1f} cm{pixels}"
        yield Fact("Residual", residual, "between map and road, on the ground and in the image, root mean square")
    error = check["error"]
    if error is not None:
        east, north, turn = np.sqrt(np.diag(error["covariance"]))
        shift = "what this calibration puts there, minus where it is by the map"
        yield Fact("Off to the east", _with_doubt(100 * error["east_m"], 100 * east, 1, " cm"), shift)
        yield Fact("Off to the north", _with_doubt(100 * error["north_m"], 100 * north, 1, " cm"), "the same")
        turned = _with_doubt(error["turn_deg"], float(np.degrees(turn)), 3, "°")
        yield Fact("Turned", turned, "counter-clockwise about the middle of what was found")


def _line(line: Document) -> LineFacts:
    remark = "off on its own; left out" if line["astray"] else "" if line["found"] else "too little found"
    if line["hidden_m"]:
        remark = "; ".join(filter(None, [remark, f"{line['hidden_m']:.0f} m hidden by the background"]))
    offsets = [(100, line["offset_m"], line["sigma_m"]), (1, line["offset_px"], line["sigma_px"])]
    in_cm, in_px = ("–" if value is None else _with_doubt(k * value, k * doubt, 1) for k, value, doubt in offsets)
    return LineFacts(
        line["id"], line["kind"], f"{line['in_view_m']:.0f}", f"{line['found_m']:.0f}", in_cm, in_px, remark
    )


def _with_doubt(value: float, sigma: float, digits: int, unit: str = "") -> str:
    return f"{signed(value, digits)} ± {sigma:.{digits}f}{unit}"
