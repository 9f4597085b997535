from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.core.frames import FloatArray, rotate_xy, wrap
from laci_stereo.core.placement.by_paper import place_by_paper
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking.tracks import Track
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
    assert placement.fit.frames == (~last).sum()
    assert abs(float(wrap(placement.fit.match.yaw_rad - TRUTH.yaw_rad))) < 1e-3
    assert placement.fit.match.shift == pytest.approx(TRUTH.shift, abs=0.02)


def test_the_paper_takes_them_where_there_is_nothing_else() -> None:
    placement = place_by_paper(seen(np.ones(len(STAMPS), dtype=bool)), vehicle(), MatchSettings())
    assert placement.fit.frames == len(STAMPS)
    assert np.linalg.norm(placement.fit.match.shift - TRUTH.shift) > 1.0
