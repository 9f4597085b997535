from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.errors import MatchError
from laci_stereo.core.estimation.joint import fit_jointly
from laci_stereo.core.frames import FloatArray, rotate_xy, wrap
from laci_stereo.core.placement import place, place_by_paper
from laci_stereo.core.settings import MatchSettings, Settings
from laci_stereo.core.tracking.tracks import Track
from tests.core import outlines
from tests.core.tracks import DRIVE, TRUTH, sighting, vehicle

STAMPS = np.arange(0.0, 6.0, 0.1)


def seen(end_on: FloatArray) -> Track:
    """Return whole boxes of a drive, and where ``end_on`` its rear alone, which is half a length behind the middle."""
    xy, yaw = DRIVE.at(STAMPS)
    rear = xy - 2.2 * np.column_stack([np.cos(yaw), np.sin(yaw)])
    level = rotate_xy(-TRUTH.yaw_rad, np.where(end_on[:, None], rear, xy) - TRUTH.shift)
    turned = yaw - TRUTH.yaw_rad
    return Track(
        tuple(
            sighting(float(t), at, size=(1.8, 0.3) if end else (4.4, 1.8), yaw_rad=float(turn))
            for t, at, turn, end in zip(STAMPS, level, turned, end_on, strict=True)
        )
    )


def test_the_paper_leaves_out_boxes_that_show_an_end_only() -> None:
    last = STAMPS > 4.0
    placement = place_by_paper(seen(last), vehicle(), MatchSettings())
    assert placement.left_out == {"thin": last.sum()}
    assert placement.frames_used == (~last).sum()
    assert abs(float(wrap(placement.match.yaw_rad - TRUTH.yaw_rad))) < 1e-3
    assert placement.match.shift == pytest.approx(TRUTH.shift, abs=0.02)


def test_the_paper_takes_them_where_there_is_nothing_else() -> None:
    placement = place_by_paper(seen(np.ones(len(STAMPS), dtype=bool)), vehicle(), MatchSettings())
    assert placement.frames_used == len(STAMPS)
    assert np.linalg.norm(placement.match.shift - TRUTH.shift) > 1.0


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
        assert place(fit, [whole], len(whole), Settings()).frames_used > 0.9 * len(whole)
    else:
        with pytest.raises(MatchError, match=r"the outline .* explains \d+% of the vehicle's points; needed are 50%"):
            place(fit, [whole], len(whole), Settings())
