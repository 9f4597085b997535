from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.errors import MatchError
from laci_stereo.core.estimation.joint import fit_jointly
from laci_stereo.core.frames import rotate_xy
from laci_stereo.core.placement.place import place
from laci_stereo.core.settings import Settings
from tests.core import outlines


@pytest.mark.parametrize(("share", "accepted"), [(0.2, True), (0.7, False)])
def test_an_outline_that_explains_too_little_is_refused(share: float, accepted: bool) -> None:
    # What stands on either side of the vehicle, 4 to 8 m away, is taken for a part of it.
    whole = outlines.evidence(outlines.STRAIGHT)
    rng = np.random.default_rng(1)
    other = np.flatnonzero(rng.random(len(whole.points)) < share)
    points = whole.points.copy()
    away = rng.uniform(4.0, 8.0, len(other)) * rng.choice([-1.0, 1.0], len(other))
    points[other, :2] = rotate_xy(away / np.linalg.norm(points[other, :2], axis=1), points[other, :2])
    fit = fit_jointly([replace(whole, points=points)], outlines.TRUTH)
    if accepted:
        assert place(fit, [whole], len(whole), Settings()).fit.frames > 0.9 * len(whole)
    else:
        with pytest.raises(MatchError, match=r"the outline .* explains \d+% of the vehicle's points; needed are 50%"):
            place(fit, [whole], len(whole), Settings())
