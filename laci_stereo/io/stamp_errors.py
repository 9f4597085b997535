"""Errors of the times of images or scans, as where these are times of arrival at a computer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import IntArray
from laci_stereo.core.settings import SYNCHRONISED_S, MatchSettings

PASSING_MPS = 15.0
"""Speed of a vehicle in a town."""

STEADILY = 2.0
"""Standard deviations: intervals of a sensor that is released irregularly look like a steady one's with wrong times in
one recording of thirty."""

LEAST_INTERVALS = 3
"""Number of intervals from which the covariance two apart has a value."""


@dataclass(frozen=True)
class StampErrors:
    """Errors of the times of images or scans.

    Attributes
    ----------
    what : str
        What the times are of, in the plural.
    sigma_s : float
        Standard deviation of their errors, seconds; 0 if they show none.
    """

    what: str
    sigma_s: float

    @staticmethod
    def of(what: str, stamps_ns: IntArray) -> StampErrors:
        """Estimate the errors from the intervals between the stamps, shape (n,), ascending.

        An error makes the interval before an image longer by what it makes the one after it shorter. So its variance is
        minus the covariance of successive intervals, which is zero for a camera that is released irregularly. Where
        images are left out regularly, intervals two apart are correlated as much; with errors they are not, but for a
        third by chance.
        """
        intervals_s = np.diff(stamps_ns) / 1e9
        if len(intervals_s) < LEAST_INTERVALS:
            return StampErrors(what, 0.0)
        # Images that are missing are no errors: a pause counts as one of them.
        off_s = np.minimum(intervals_s, 2.0 * np.median(intervals_s))
        off_s -= off_s.mean()
        square, beside, two_apart = (float(np.mean(off_s[step:] * off_s[: len(off_s) - step])) for step in range(3))
        surely = -beside * np.sqrt(len(off_s)) > STEADILY * square and abs(two_apart) < -0.75 * beside
        return StampErrors(what, float(np.sqrt(-beside)) if surely else 0.0)

    @property
    def notes(self) -> tuple[str, ...]:
        """A line that tells them, if they are larger than the differences between synchronised clocks."""
        if self.sigma_s <= SYNCHRONISED_S:
            return ()
        words = (
            f"the {self.what}' times err by {1e3 * self.sigma_s:.0f} ms (one standard deviation): an interval that is "
            "too long is followed by one that is too short, as with times of arrival; a vehicle at "
            f"{PASSING_MPS:g} m/s drives {PASSING_MPS * self.sigma_s:.2f} m meanwhile, which the uncertainty does not "
            "include; needed are the times at which they were taken"
        )
        return (words,)

    def doubts(self, settings: MatchSettings) -> tuple[str, ...]:
        """Return the same line if, in the fewest frames that suffice, the mean error exceeds that of the clocks."""
        return self.notes if self.sigma_s > SYNCHRONISED_S * np.sqrt(settings.min_frames) else ()
