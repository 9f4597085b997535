"""Where across a map's lines what they stand for was seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from laci_stereo.check.profiles import OFFSETS_M
from laci_stereo.core.frames import BoolArray, FloatArray

SURE = 4.0
"""Sigma. Of some 10 000 places that are looked at, noise alone passes at less than one."""

DOUBTFUL = 2.0
"""Sigma below which something counts nothing; what is between counts in part, for paint wears off."""


@dataclass(frozen=True)
class Traces:
    """How much each place across a line looks like what the map has there.

    Attributes
    ----------
    sigmas : ndarray, shape (n, m)
        How far it stands out at `OFFSETS_M`, in standard deviations of what is around; 0 where nothing was seen.
    left_m : ndarray, shape (n, m)
        Its exact place, to the left of the line, where it stands out most.
    cell_m : ndarray, shape (n,)
        What a pixel, or the spacing of points, covers across the line; infinite where the line is not in view.
    loose_m : ndarray, shape (n,)
        Standard deviation of what the map means against what is seen, the same along a line.
    in_image : bool
        Cells are pixels.
    """

    sigmas: FloatArray
    left_m: FloatArray
    cell_m: FloatArray
    loose_m: FloatArray
    in_image: bool = False

    @staticmethod
    def unseen(count: int) -> Traces:
        """Return what is seen of sections that are not in view."""
        nothing = np.zeros((count, len(OFFSETS_M)))
        return Traces(nothing, nothing.copy(), np.full(count, np.inf), np.zeros(count))

    def __getitem__(self, chosen: BoolArray) -> Traces:
        return Traces(
            self.sigmas[chosen], self.left_m[chosen], self.cell_m[chosen], self.loose_m[chosen], self.in_image
        )

    def put(self, chosen: BoolArray, traces: Traces) -> Traces:
        """Return these with others, shape (k, m), in place of the chosen ones."""
        whole = Traces(self.sigmas.copy(), self.left_m.copy(), self.cell_m.copy(), self.loose_m.copy(), self.in_image)
        whole.sigmas[chosen], whole.left_m[chosen] = traces.sigmas, traces.left_m
        whole.cell_m[chosen], whole.loose_m[chosen] = traces.cell_m, traces.loose_m
        return whole

    @property
    def evidence(self) -> FloatArray:
        """From 0 to 1, shape (n, m)."""
        return np.clip((self.sigmas - DOUBTFUL) / (SURE - DOUBTFUL), 0.0, 1.0)

    @property
    def peaks(self) -> FloatArray:
        """The evidence where it is greatest among its neighbours, else 0, shape (n, m)."""
        return np.where(highest(self.sigmas), self.evidence, 0.0)


def highest(sigmas: FloatArray) -> BoolArray:
    """Tell where values, shape (n, m), stand out most among their neighbours."""
    return np.asarray(sigmas == maximum_filter1d(sigmas, 5, axis=1, mode="constant"))
