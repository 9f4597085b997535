"""The page that compares several results of one sensor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from laci_stereo.report.page.page import policy_for, template, text_of


@dataclass(frozen=True)
class Row:
    """A quantity's difference between two results, and the difference's standard deviation, NaN where unknown."""

    name: str
    value: float
    sigma: float
    unit: str

    @property
    def sigmas(self) -> float | None:
        """The difference in standard deviations; None where the standard deviation is unknown."""
        return None if math.isnan(self.sigma) else self.value / self.sigma


@dataclass(frozen=True)
class Pair:
    """Two results, their differences and whether they agree."""

    first: str
    second: str
    rows: tuple[Row, ...]
    outcome: Literal["agree", "contradict", "cannot tell"]
    chance: str


def write_compare_page(pairs: Sequence[Pair], shared: str) -> str:
    """Return the page, as HTML that loads no external resources.

    ``shared`` tells the errors common to all results, which the standard deviations do not include.
    """
    style = text_of("page.css")
    return template("page.compare.j2").render(pairs=pairs, shared=shared, style=style, policy=policy_for(style, ""))
