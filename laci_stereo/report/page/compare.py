"""A page that shows by how much results of one sensor differ."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from laci_stereo.report.page.page import policy_for, template, text_of


@dataclass(frozen=True)
class Row:
    """A quantity: how far apart, and one sigma of that; NaN where it is not known."""

    name: str
    value: float
    sigma: float
    unit: str

    @property
    def sigmas(self) -> float | None:
        """How many sigma apart; None where that is not known."""
        return None if math.isnan(self.sigma) else self.value / self.sigma


@dataclass(frozen=True)
class Pair:
    """Two results, and whether they agree, in words."""

    first: str
    second: str
    rows: tuple[Row, ...]
    outcome: Literal["agree", "contradict", "cannot tell"]
    chance: str


def write_compare_page(pairs: Sequence[Pair], shared: str) -> str:
    """Write the page.

    Parameters
    ----------
    pairs : sequence of Pair
    shared : str
        What the sigmas leave out.

    Returns
    -------
    str
        HTML that asks for nothing outside of itself.
    """
    style = text_of("page.css")
    return template("page.compare.j2").render(pairs=pairs, shared=shared, style=style, policy=policy_for(style, ""))
