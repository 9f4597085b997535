from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from laci_stereo.core.frames import FloatArray
from laci_stereo.report.lines import MAX_STEPS, clip, clip_slab, dashes, subdivide

polylines = st.integers(2, 8).flatmap(lambda n: arrays(np.float64, (n, 2), elements=st.integers(-50, 50).map(float)))


def length(line: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


@given(polylines, st.floats(0.1, 20.0))
def test_subdividing_keeps_the_line(line: FloatArray, step: float) -> None:
    fine = subdivide(line, step)
    assert np.linalg.norm(np.diff(fine, axis=0), axis=1).max() <= step * (1 + 1e-9)
    np.testing.assert_allclose(length(fine), length(line))
    np.testing.assert_allclose(fine[[0, -1]], line[[0, -1]])


def test_a_long_segment_costs_no_more_than_the_limit() -> None:
    assert len(subdivide(np.array([[0.0, 0.0], [1e7, 0.0]]), 0.5)) == MAX_STEPS + 1


@given(polylines)
def test_what_a_plane_cuts_off_and_what_it_leaves_are_the_whole(line: FloatArray) -> None:
    inside = line[:, 0] - 0.5
    kept, lost = clip(line, inside), clip(line, -inside)
    assert all((piece[:, 0] >= 0.5 - 1e-9).all() for piece in kept)
    assert all((piece[:, 0] <= 0.5 + 1e-9).all() for piece in lost)
    np.testing.assert_allclose(sum(map(length, kept)) + sum(map(length, lost)), length(line), atol=1e-9)


def test_a_slab_cuts_on_both_sides() -> None:
    (piece,) = clip_slab(np.array([[-10.0, 0.0], [10.0, 20.0]]), 0, -1.0, 2.0)
    np.testing.assert_allclose(piece, [[-1.0, 9.0], [2.0, 12.0]])


@given(polylines, st.floats(0.5, 9.0), st.floats(0.5, 9.0))
def test_dashes_cover_their_share_of_the_line(line: FloatArray, on: float, off: float) -> None:
    whole, rest = divmod(length(line), on + off)
    np.testing.assert_allclose(sum(map(length, dashes(line, on, off))), whole * on + min(rest, on), atol=1e-6)
