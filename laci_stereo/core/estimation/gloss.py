"""What a glossy side mirrors: a matcher that sees it instead of the side finds it behind the side.

The image of the surroundings in a flat side is as far behind it as they are before it. In a window of the matcher both
are seen at once, and its shift lies between, so that ranges are too long, and the more so the flatter the side is
seen, and the darker it is.
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

EXPECTED = (SHIFT, 0.0)
"""Of this shift by all paints' mean, and of that by which one paint's differs, see `mirrored`."""

SIGMA = (SHIFT, float(np.sqrt(2.0)) * SHIFT)
"""Standard deviations of both: the mean square of an exponential distribution is twice its squared mean."""

_COS = np.linspace(0.0, 1.0, 257)
_PAINTS = np.geomspace(*SCATTERED, 129)[1::2]


def mirrored(cos: FloatArray) -> FloatArray:
    """Return how much of what a matcher sees is mirrored, shape (n, 2), by the cosine of the angle of incidence, (n,).

    A least-squares shift is the mean of those of two layers, weighted by their squared gradients, so by the squares of
    the light that is mirrored (Schlick, Computer Graphics Forum 1994, equation 15) and of what paint scatters of the
    rest. The first is its mean over all paints, in closed form. The second is how single paints differ from that: their
    first principal component, nine tenths of their variance. Black paint mirrors half of what is seen of it even if it
    is looked at straight, so that all of a black body is too far away; white paint only where it is grazed.
    """
    light = _light(cos)
    of_black, of_white = ((1.0 - light) ** 2 + (light / paint) ** 2 for paint in SCATTERED)
    mean = np.log(of_black / of_white) / (2.0 * np.log(SCATTERED[1] / SCATTERED[0]))
    return np.column_stack([mean, np.interp(cos, _COS, _DARKER)])


def _light(cos: FloatArray) -> FloatArray:
    light: FloatArray = MIRRORED + (1.0 - MIRRORED) * (1.0 - cos) ** 5
    return light


def _darker() -> FloatArray:
    """Return how much more is mirrored, at the angles `_COS`, of paint that is darker by a standard deviation."""
    light = _light(_COS)
    shares = light**2 / (light**2 + ((1.0 - light) * _PAINTS[:, None]) ** 2)
    _, sizes, ways = np.linalg.svd(shares - shares.mean(axis=0), full_matrices=False)
    darker: FloatArray = ways[0] * (np.sign(ways[0].sum()) * sizes[0] / np.sqrt(len(_PAINTS)))
    return darker


_DARKER = _darker()
