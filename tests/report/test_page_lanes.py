"""What the page says of the lane check."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator, ValidationError

from laci_stereo.io.result.calibration_file import schema, to_document
from laci_stereo.report.page import Made, write_page
from tests.report.page_support import PROVENANCE, Element, read
from tests.report.support import calibration

HOSTILE = "<script>alert(1)</script>"


def lane_check(verdict: str, *reasons: str, line_id: str = "17") -> dict[str, Any]:
    line = {"id": line_id, "kind": "line_thin", "in_view_m": 12, "hidden_m": 3, "found_m": 9, "found": True}
    offsets = {"astray": False, "offset_m": -0.042, "sigma_m": 0.011, "offset_px": -1.5, "sigma_px": 0.4}
    unseen = {"offset_m": None, "sigma_m": None, "offset_px": None, "sigma_px": None}
    return {
        "verdict": verdict,
        "reasons": list(reasons),
        "lines_in_view": 2,
        "lines_found": 1,
        "residual_m": 0.051,
        "residual_px": 1.23,
        "map_sigma_m": 0.05,
        "error": {
            "east_m": 0.034,
            "north_m": -0.021,
            "turn_deg": 0.056,
            "centre_world": [1.0, 2.0],
            "covariance": np.diag([1e-4, 4e-4, 1e-6]).tolist(),
            "chi_square": 2.5,
        },
        "lines": [{**line, **offsets}, {**line, "id": "18", "found_m": 0, "found": False, "astray": False, **unseen}],
    }


def page(check: dict[str, Any] | None, picture: np.ndarray | None = None) -> Element:
    found = calibration()
    return read(write_page(found, to_document(found, PROVENANCE, check), Made(PROVENANCE, "47", check=picture)))


def section(of: Element) -> Element:
    return of.one("section", id="lanes")


@pytest.mark.parametrize(
    ("verdict", "look", "begins"),
    [("pass", "pass", "Yes"), ("fail", "fail", "No"), ("cannot tell", "warn", "The lines")],
)
def test_verdict_is_said_first(verdict: str, look: str, begins: str) -> None:
    (sentence,) = section(page(lane_check(verdict))).all("p", look=f"sentence {look}")
    assert sentence.text.startswith(begins)


def test_figures_stand_in_the_page() -> None:
    text = section(page(lane_check("fail", "the lines are off"))).text
    for figure in (
        "1 of 2",
        "5.1 cm, 1.2 px",
        "+3.4 ± 1.0 cm",
        "−2.1 ± 2.0 cm",
        "+0.056 ± 0.057°",
        "−4.2 ± 1.1",
        "−1.5 ± 0.4",
    ):
        assert figure in text
    assert "The lines are off." in text
    assert "3 m hidden" in text


def test_page_without_a_check_has_no_such_section() -> None:
    plain = page(None)
    assert not plain.all("section", id="lanes")
    assert not plain.all("a", href="#lanes")
    assert section(page(lane_check("pass")))
    assert page(lane_check("pass")).one("a", href="#lanes")


def test_picture_is_in_the_page() -> None:
    grey = np.full((60, 80), 90, dtype=np.uint8)
    image = section(page(lane_check("pass"), grey)).one("img")
    assert image.attributes["src"].startswith("data:image/jpeg;base64,")
    assert image.attributes["alt"]
    assert not section(page(lane_check("pass"))).all("img")


def test_names_of_a_map_are_only_text() -> None:
    lanes = section(page(lane_check("fail", HOSTILE, line_id=HOSTILE)))
    assert not lanes.all("script")
    assert lanes.text.count(HOSTILE) == 2


@pytest.mark.parametrize(
    ("name", "value"),
    [("verdict", "maybe"), ("lines_found", -1), ("error", {}), ("surprise", 1), ("residual_m", "5 cm")],
)
def test_schema_holds_the_check(name: str, value: object) -> None:
    document = to_document(calibration(), PROVENANCE, lane_check("pass"))
    document["lane_check"][name] = value
    with pytest.raises(ValidationError):
        Draft202012Validator(schema()).validate(document)
