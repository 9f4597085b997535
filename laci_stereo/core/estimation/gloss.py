"""The bias of ranges by specular reflection: a matcher that sees a mirror image in a side finds it behind the side.

The mirror image of the surroundings in a flat side is as far behind it as they are in front of it. A matching window
sees both the side and the mirror image, and its disparity lies between theirs. Ranges are therefore too long, the more
so the larger the angle of incidence and the darker the side.
"""

from __future__ import annotations

import numpy as np

from laci_stereo.core.frames import FloatArray

MIRRORED = 0.04
"""Fraction of the light that clear coat and glass reflect specularly at normal incidence: ((n - 1) / (n + 1))^2, with a
refractive index n of 1.5."""

SCATTERED = (0.04, 0.8)
"""Fractions of the light that black and white paint scatter; the logarithm of any other paint's fraction is uniformly
distributed between theirs."""

SHIFT = 2.0
"""Mean bias of ranges, in standard deviations of the points, where only the mirror image is seen: if it were more than
a few, there would be no match. How glossy a body is, and what there is to reflect, is unknown and ranges from nothing
to much: an exponential distribution, whose standard deviation equals its mean; it is approximated by a normal
distribution."""

EXPECTED = (SHIFT, 0.0)
"""Prior means of the bias with the mean of all paints, and of the difference by which one paint's departs from it, see
`mirrored`."""

SIGMA = (SHIFT, float(np.sqrt(2.0)) * SHIFT)
"""Prior standard deviations of both: the mean square of an exponential distribution is twice its squared mean."""

_COS = np.linspace(0.0, 1.0, 257)
_PAINTS = np.geomspace(*SCATTERED, 129)[1::2]


def mirrored(cos: FloatArray) -> FloatArray:
    """Return the weight of the mirror image in a match, shape (n, 2), by the cosine of the angle of incidence, (n,).

    A least-squares disparity is the mean of those of two layers, weighted by their squared gradients, hence by the
    squares of the light that is reflected specularly (Schlick, Computer Graphics Forum 1994, equation 15) and of the
    part of the remaining light that paint scatters. The first column is the mean of that weight over all paints, in
    closed form. The second column is how single paints differ from it: their first principal component, with nine
    tenths of their variance. In black paint the mirror image has half of the weight even at normal incidence, so that
    all of a black body is found too far away; in white paint it matters only at grazing incidence.
    """
    light = _light(cos)
    of_black, of_white = ((1.0 - light) ** 2 + (light / paint) ** 2 for paint in SCATTERED)
    mean = np.log(of_black / of_white) / (2.0 * np.log(SCATTERED[1] / SCATTERED[0]))
    return np.column_stack([mean, np.interp(cos, _COS, _DARKER)])


def _light(cos: FloatArray) -> FloatArray:
    light: FloatArray = MIRRORED + (1.0 - MIRRORED) * (1.0 - cos) ** 5
    return light


def _darker() -> FloatArray:
    """Return the additional weight of the mirror image, at `_COS`, in paint darker by one standard deviation."""
    light = _light(_COS)
    shares = light**2 / (light**2 + ((1.0 - light) * _PAINTS[:, None]) ** 2)
    _, sizes, ways = np.linalg.svd(shares - shares.mean(axis=0), full_matrices=False)
    darker: FloatArray = ways[0] * (np.sign(ways[0].sum()) * sizes[0] / np.sqrt(len(_PAINTS)))
    return darker


_DARKER = _darker()
