"""``report.html``: one self-contained, self-explanatory HTML file that opens offline."""

from __future__ import annotations

import hashlib
import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined, Template

from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.frames import Raster
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import JointSettings
from laci_stereo.core.threads import in_one_thread
from laci_stereo.io.maps.lane_map import LaneMap
from laci_stereo.io.result.calibration_file import Document, Provenance
from laci_stereo.report.page import facts
from laci_stereo.report.page.charts import Chart, OutlineChart, Series, chart, outline_chart
from laci_stereo.report.page.lanes import lane_facts
from laci_stereo.report.page.photo import Photographs, draw_over, jpeg
from laci_stereo.report.page.plan import draw_plan
from laci_stereo.report.page.residuals import Laid, centre_offsets, fit_drive, median_by_frame
from laci_stereo.report.page.shapes import thinned

MOST_FRAMES = 600
"""Largest number of marks of a chart that can still be distinguished."""


@dataclass(frozen=True)
class Made:
    """How a result was made, for the page.

    Attributes
    ----------
    provenance : Provenance
    read : str
        Description of the input files.
    skipped : tuple of str
        Inputs that were left out, one line each.
    lane_map : LaneMap or None
    photographs : Photographs or None
        Camera images; None for sensors without images.
    command : str or None
        The command line; None if called from Python.
    check : ndarray or None
        The picture of the lane check, where there is one.
    """

    provenance: Provenance
    read: str
    skipped: tuple[str, ...] = ()
    lane_map: LaneMap | None = None
    photographs: Photographs | None = None
    command: str | None = None
    check: Raster | None = None


@dataclass(frozen=True)
class DrivePage:
    """The charts and tables of one drive.

    Attributes
    ----------
    name : str
        Empty if the drive is the only one.
    over_time : Chart or None
        Residuals over time.
    around : OutlineChart or None
        Points around the vehicle from above.
    sides : tuple of facts.Side
        Residuals of each side of the vehicle.
    corrections : tuple of facts.Corrected
        Estimated corrections to the messages.
    """

    name: str
    over_time: Chart | None
    around: OutlineChart | None
    sides: tuple[facts.Side, ...]
    corrections: tuple[facts.Corrected, ...]


def write_page(calibration: Calibration, document: Document, made: Made) -> str:
    """Return the report page, as HTML that loads no external resources; ``document`` is that of `to_document`."""
    provenance = made.provenance
    photo = None if made.photographs is None else draw_over(made.photographs, calibration, made.lane_map)
    plan = draw_plan(calibration, made.lane_map)
    lane_check = document["lane_check"]
    contradicted = lane_check is not None and lane_check["verdict"] == "fail"
    style, script = text_of("page.css"), text_of("page.js")
    return template("page.html.j2").render(
        policy=policy_for(style, script),
        style=style,
        script=script,
        calibration=calibration,
        document=document,
        made=made,
        verdict=facts.verdict_of(calibration, bool(photo and photo.shots), contradicted),
        matrices=facts.matrices(calibration, provenance),
        place=facts.place_facts(calibration),
        doubt=facts.doubt_facts(calibration),
        clock=facts.clock_facts(calibration),
        paper=facts.beside_paper(calibration),
        drives=facts.drives(calibration) if calibration.others else (),
        left_out=facts.left_out(calibration),
        settings=list(facts.settings(document["config"])),
        fitted=_fitted(calibration, document["config"]),
        photo=photo,
        plan=plan,
        lanes=lane_facts(lane_check),
        lanes_picture=None if made.check is None else jpeg(made.check),
    )


@in_one_thread
def _fitted(calibration: Calibration, config: Mapping[str, Any]) -> list[DrivePage]:
    settings = JointSettings(**config.get("joint", {}))
    several = bool(calibration.others)
    return [
        _drive_page(calibration, passage, settings, f"Drive {number}" if several else "")
        for number, passage in enumerate(calibration.passages, start=1)
    ]


def _drive_page(calibration: Calibration, passage: Passage, settings: JointSettings, name: str) -> DrivePage:
    fit = fit_drive(passage, settings) if calibration.drive.method == "joint" else None
    corrections = () if fit is None else facts.corrected(fit.corrections)
    if fit is None or fit.laid is None:
        return DrivePage(name, _centres_chart(passage), None, (), corrections)
    size = (passage.vehicle.length_m, passage.vehicle.width_m)
    around = outline_chart(size, fit.laid.xy_vehicle, fit.laid.surface)
    return DrivePage(name, _outline_over_time(fit.laid), around, facts.sides(fit.laid), corrections)


def _outline_over_time(laid: Laid) -> Chart | None:
    parts = [("ends", "front and rear (along the vehicle)", (0, 1)), ("flanks", "left and right side (across)", (2, 3))]
    series = [_by_frame(laid, look, label, faces) for look, label, faces in parts]
    shown = [each for each in series if len(each.x)]
    title = "Distance of the points from the vehicle's outline, frame by frame"
    return chart(title, "time since the first frame [s]", "distance [cm]", shown) if shown else None


def _by_frame(laid: Laid, look: str, label: str, faces: tuple[int, int]) -> Series:
    chosen = np.isin(laid.face, faces) & (laid.surface >= 0.5)
    stamps_s, quartiles = median_by_frame(laid.stamps_s[chosen], 100.0 * laid.distance_m[chosen])
    stamps_s, quartiles = thinned(stamps_s, MOST_FRAMES), thinned(quartiles, MOST_FRAMES)
    return Series(look, label, stamps_s, quartiles[:, 1], quartiles[:, 0], quartiles[:, 2])


def _centres_chart(passage: Passage) -> Chart | None:
    offsets = centre_offsets(passage)
    if not len(offsets.stamps_s):
        return None
    columns = offsets.stamps_s, offsets.ahead_m, offsets.left_m
    stamps_s, ahead_m, left_m = (thinned(column, MOST_FRAMES) for column in columns)
    series = [
        Series("ends", "ahead of the vehicle's middle", stamps_s, 100.0 * ahead_m),
        Series("flanks", "to its left", stamps_s, 100.0 * left_m),
    ]
    title = "Middle of the sensor's box against the vehicle's middle by the messages, frame by frame"
    return chart(title, "time since the first frame [s]", "distance [cm]", series)


def policy_for(style: str, script: str) -> str:
    """Return a content security policy that allows only this style, this script and images embedded in the page.

    See Content Security Policy Level 3 (W3C), section 2.3.1, for the hashes.
    """
    digests = (b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in (style, script))
    of_style, of_script = digests
    return (
        f"default-src 'none'; img-src data:; style-src 'sha256-{of_style}'; script-src 'sha256-{of_script}'; "
        "base-uri 'none'; form-action 'none'"
    )


@cache
def text_of(name: str) -> str:
    """Return the text of a file of this package."""
    return files("laci_stereo.report.page").joinpath(name).read_text(encoding="utf-8")


@cache
def template(name: str) -> Template:
    """Return a template of this package."""
    # All external text is escaped; only this package's style and script are marked as safe in the template.
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters["data"] = _data
    return environment.from_string(text_of(name))


def _data(values: Sequence[object]) -> str:
    """Return values as compact JSON, which the template escapes into an attribute."""
    return json.dumps(values, ensure_ascii=False, separators=(",", ":"))
