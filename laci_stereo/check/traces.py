"""Detections across a map's lines of the features that these stand for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from laci_stereo.check.profiles import OFFSETS_M
from laci_stereo.core.frames import BoolArray, FloatArray

SURE = 4.0
"""Significance of a sure detection, standard deviations: of some 10 000 places tested, noise alone reaches it at less
than one."""

DOUBTFUL = 2.0
"""Significance below which a response does not count, standard deviations; values in between count in part, because
paint wears off."""


@dataclass(frozen=True)
class Traces:
    """Significance and position, across each section, of what resembles the mapped feature.

    Attributes
    ----------
    sigmas : ndarray, shape (n, m)
        Significance at `OFFSETS_M`: response in standard deviations of its surroundings; 0 if nothing was seen.
    left_m : ndarray, shape (n, m)
        Exact position at local maxima, to the left of the line.
    cell_m : ndarray, shape (n,)
        Width that a pixel, or the spacing of points, covers across the line; infinite if the line is not in view.
    loose_m : ndarray, shape (n,)
        Standard deviation of the offset between the mapped and the visible feature, constant along a line.
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
        """Return empty traces of sections that are not in view."""
        nothing = np.zeros((count, len(OFFSETS_M)))
        return Traces(nothing, nothing.copy(), np.full(count, np.inf), np.zeros(count))

    def __getitem__(self, chosen: BoolArray) -> Traces:
        return Traces(
            self.sigmas[chosen], self.left_m[chosen], self.cell_m[chosen], self.loose_m[chosen], self.in_image
        )

    def put(self, chosen: BoolArray, traces: Traces) -> Traces:
        """Return a copy in which the chosen sections, k of them, are replaced by others, shape (k, m)."""
        whole = Traces(self.sigmas.copy(), self.left_m.copy(), self.cell_m.copy(), self.loose_m.copy(), self.in_image)
        whole.sigmas[chosen], whole.left_m[chosen] = traces.sigmas, traces.left_m
        whole.cell_m[chosen], whole.loose_m[chosen] = traces.cell_m, traces.loose_m
        return whole

    @property
    def evidence(self) -> FloatArray:
        """Significance mapped to a weight from 0 to 1, shape (n, m)."""
        return np.clip((self.sigmas - DOUBTFUL) / (SURE - DOUBTFUL), 0.0, 1.0)

    @property
    def peaks(self) -> FloatArray:
        """The evidence at local maxima, else 0, shape (n, m)."""
        return np.where(highest(self.sigmas), self.evidence, 0.0)


def highest(sigmas: FloatArray) -> BoolArray:
    """Return where values, shape (n, m), are local maxima along each row."""
    return np.asarray(sigmas == maximum_filter1d(sigmas, 5, axis=1, mode="constant"))
