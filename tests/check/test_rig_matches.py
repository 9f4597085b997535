"""Matches between the images of a pair."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from laci_stereo.check.rig_matches import Compared, match_pair

DATA = Path(__file__).parents[2] / "calib_data"


def test_features_of_large_images_are_searched_smaller_and_as_exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """At full size, the search in 20 megapixels takes 5 GB."""
    name = sorted(each.name for each in (DATA / "left").iterdir())[0]
    left, right = (cv2.imread(str(DATA / side / name), cv2.IMREAD_GRAYSCALE) for side in ("left", "right"))
    whole = match_pair(Compared(left, right, None, 0.0))
    monkeypatch.setattr("laci_stereo.check.rig_matches.SEARCHED_PIXELS", left.size // 3)
    small = match_pair(Compared(left, right, None, 0.0))
    assert len(whole.left) != len(small.left) > 300
    off = [np.percentile(np.subtract(found.left, found.right)[:, 1], [25, 50, 75]) for found in (whole, small)]
    np.testing.assert_allclose(off[0], off[1], atol=0.02)
