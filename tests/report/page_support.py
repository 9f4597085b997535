"""A report page, and what a parser reads in it."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from html.parser import HTMLParser

import numpy as np

from laci_stereo.core.frames import FloatArray, Raster
from laci_stereo.core.result import Calibration
from laci_stereo.io.result.calibration_file import Provenance, to_document
from laci_stereo.io.rig.stereo_rig import Lens
from laci_stereo.report.page import Made, Photograph, Photographs, write_page
from tests.report.support import lane, lane_map, lens

PROVENANCE = Provenance(
    name="mast 7",
    kind="stereo",
    frame="raw left camera",
    inputs={"left": 47, "cam.csv": "ab" * 32},
    config={"method": "joint", "joint": {"clock_sigma_s": 0.01, "block_s": 1.0}, "workers": 0},
    notes=("2 left images without a partner",),
)


@dataclass
class Element:
    tag: str
    attributes: dict[str, str]
    text: str = ""
    inside: list[Element] = field(default_factory=list)

    @property
    def classes(self) -> set[str]:
        return set(self.attributes.get("class", "").split())

    def all(self, tag: str = "", **attributes: str) -> list[Element]:
        """Find elements below, in the order of the page; of ``look`` each word must be a class."""
        looks = set(attributes.pop("look", "").split())
        wanted = {name.replace("_", "-"): value for name, value in attributes.items()}
        return [
            each
            for each in self.inside
            if tag in ("", each.tag)
            and looks <= each.classes
            and all(each.attributes.get(name) == value for name, value in wanted.items())
        ]

    def one(self, tag: str = "", **attributes: str) -> Element:
        (found,) = self.all(tag, **attributes)
        return found


VOID = {"meta", "link", "input", "br", "img", "hr"}


class Reader(HTMLParser):
    """Builds elements, each of which knows all that is inside of it, at any depth."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.root = Element("", {})
        self.open = [self.root]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._add(tag, attrs)
        if tag in VOID:
            self.open.pop()

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._add(tag, attrs)
        self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop().tag == tag

    def handle_data(self, data: str) -> None:
        for each in self.open:
            each.text += data

    def _add(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        element = Element(tag, {name: value or "" for name, value in attrs})
        for each in self.open:
            each.inside.append(element)
        self.open.append(element)


def read(html: str) -> Element:
    reader = Reader()
    reader.feed(html)
    reader.close()
    assert reader.open == [reader.root]  # every element is closed
    return reader.root


def page(calibration: Calibration, made: Made | None = None) -> str:
    made = made or Made(PROVENANCE, "47 image pairs")
    return write_page(calibration, to_document(calibration, made.provenance), made)


def with_images(through: Lens | None = None, image: Raster | None = None) -> Made:
    """A page's origin with two images of a road with one solid line on the ground."""
    through = through or lens()
    if image is None:
        ramp = np.linspace(0, 255, through.size[0]).astype(np.uint8)
        image = np.repeat(np.tile(ramp, (through.size[1], 1))[:, :, None], 3, axis=2)
    shots = tuple(Photograph(stamp_s, image) for stamp_s in (1.5, 3.5))
    lanes = lane_map(lane((1.0, 12.0), (1.0, 30.0)))
    return Made(PROVENANCE, "47 image pairs", lane_map=lanes, photographs=Photographs(through, shots))


def points_of(d: str) -> FloatArray:
    """Return the points of a path that consists of moves and lines, shape (n, 2)."""
    numbers = re.findall(r"[ML](-?[\d.]+) (-?[\d.]+)", d)
    return np.array(numbers, dtype=np.float64).reshape(-1, 2)


def distances_to(d: str, points: FloatArray) -> FloatArray:
    """Return how far each point, shape (n, 2), is from the nearest one of a path."""
    away: FloatArray = np.linalg.norm(points[:, None] - points_of(d)[None], axis=2).min(axis=1)
    return away
