"""What a glossy side mirrors: a matcher that sees it instead of the side finds it behind the side.

The image of the surroundings in a flat side is as far behind it as they are before it. In a window of the matcher both
are seen at once, and its shift lies between, so that ranges are too long, and the more so the flatter the side is seen.
"""

from __future__ import annotations

import numpy as np

from laci_stereo.core.frames import FloatArray

MIRRORED = 0.04
"""Share of the light that clear coat and glass mirror at normal incidence: ((n - 1) / (n + 1))^2, their index n 1.5."""

SCATTERED = (0.04, 0.8)
"""Share of the light that black and white paint scatter; any in between is as likely, in their logarithms."""

SHIFT = 2.0
"""By so much ranges are too long, in standard deviations of points, where nothing but what is mirrored is seen: more
than a few, and it is no match any more. How glossy a body is, and what there is to mirror, nobody knows, from nothing
to much: an exponential distribution's mean, and so its standard deviation; it is taken for a normal one's."""


def mirrored(cos: FloatArray) -> FloatArray:
    """Return how much of what a matcher sees is mirrored, shape (n,), by the cosine of the angle of incidence, (n,).

    A least-squares shift is the mean of those of two layers, weighted by their squared gradients, so by the squares of
    the light that is mirrored (Schlick, Computer Graphics Forum 1994, equation 15) and of what paint scatters of the
    rest. Its mean over all paints is in closed form.
    """
    light = MIRRORED + (1.0 - MIRRORED) * (1.0 - cos) ** 5
    of_black, of_white = ((1.0 - light) ** 2 + (light / paint) ** 2 for paint in SCATTERED)
    share: FloatArray = np.log(of_black / of_white) / (2.0 * np.log(SCATTERED[1] / SCATTERED[0]))
    return share
