"""What is known beforehand of how a scanner rotates that does not report the points' times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from laci_stereo.core.estimation.evidence import Evidence

TURNS = {0.0: 0.5, 1.0: 0.25, -1.0: 0.25}
"""A priori probability of each direction in which a scanner without times of the points may rotate: 1 is
counter-clockwise (factor on the delays of a counter-clockwise rotation), -1 clockwise. In half of the cases it does not
rotate (0), or its points were corrected to the scan's stamp before they were written."""

FIXED = 1e-3
"""Standard deviation of the rotation factor (`Turn`) that is taken as known: above 0, so that the equations stay
regular."""


@dataclass(frozen=True)
class Turn:
    """A priori knowledge of how a scanner rotates while it takes a scan.

    Attributes
    ----------
    mean, sigma : float
        Mean and standard deviation of the rotation factor, by which the delays of a counter-clockwise rotation are
        multiplied: 1 if it rotates counter-clockwise, -1 clockwise, 0 if it does not rotate or the points' times are
        known.
    """

    mean: float
    sigma: float

    @property
    def possible(self) -> bool:
        """Whether the scanner may rotate."""
        return self.mean != 0.0 or self.sigma > FIXED


NO_TURN, ANY_TURN = Turn(0.0, FIXED), Turn(0.0, 1.0)


def turn_of(drives: Sequence[Evidence]) -> Turn:
    """Return what is known of the scanner's rotation from its drives."""
    return ANY_TURN if any(drive.turn_s for drive in drives) else NO_TURN
