"""Curves of roads are where integration, geometry and closed forms put them, and polylines stay near to them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.special import fresnel

from laci_stereo.core.frames import FloatArray
from laci_stereo.io.maps.road_geometry import (
    CHORD_M,
    Bend,
    Cubic,
    GeometryError,
    ReferenceLine,
    parameters_of_lengths,
    polyline,
)
from tests.io.support import fuzz

CURVATURE = st.floats(-0.1, 0.1)


@fuzz
@given(st.floats(0.1, 120.0), CURVATURE, CURVATURE, st.floats(-4, 4))
def test_clothoid_is_the_integral_of_its_heading(length: float, first: float, last: float, heading: float) -> None:
    bend = Bend(3.0, (10.0, -20.0), heading, length, first, (last - first) / length)

    def ahead(s: float, _xy: object) -> list[float]:
        angle = heading + first * s + (last - first) / length * s**2 / 2
        return [np.cos(angle), np.sin(angle)]

    s = np.linspace(0.0, length, 5)
    wanted = solve_ivp(ahead, (0.0, length), [10.0, -20.0], t_eval=s, rtol=1e-10, atol=1e-10).y.T
    found, headings = bend.at(s + 3.0)
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    np.testing.assert_allclose(
        headings, [heading + first * x + (last - first) / length * x**2 / 2 for x in s], atol=1e-9
    )


@fuzz
@given(st.floats(1.0, 200.0), st.floats(1e-4, 0.1))
def test_clothoid_from_a_straight_line_is_fresnels(length: float, last: float) -> None:
    scale = np.sqrt(np.pi * length / last)
    s = np.linspace(0.0, length, 9)
    sine, cosine = fresnel(s / scale)
    found, _ = Bend(0.0, (0.0, 0.0), 0.0, length, 0.0, last / length).at(s)
    np.testing.assert_allclose(found, scale * np.column_stack([cosine, sine]), atol=1e-9)


@fuzz
@given(st.floats(1.0, 300.0), st.floats(0.01, 0.2), st.floats(-3, 3))
def test_arc_is_on_its_circle(length: float, curvature: float, heading: float) -> None:
    centre = np.array([-np.sin(heading), np.cos(heading)]) / curvature
    found, _ = Bend(0.0, (0.0, 0.0), heading, length, curvature, 0.0).at(np.linspace(0, length, 20))
    np.testing.assert_allclose(np.linalg.norm(found - centre, axis=1), 1 / curvature, rtol=1e-12)


@fuzz
@given(st.floats(1.0, 100.0), st.floats(-0.1, 0.1), st.floats(-0.02, 0.02), st.floats(-1e-4, 1e-4))
def test_cubic_is_cut_off_at_its_length(length: float, b: float, c: float, d: float) -> None:
    v = np.array([0.0, b, c, d])
    end = parameters_of_lengths(np.array([0.0, 1.0, 0.0, 0.0]), v, length)
    arc, _ = quad(lambda u: np.sqrt(1.0 + (b + 2 * c * u + 3 * d * u**2) ** 2), 0.0, end)
    assert arc == pytest.approx(length, rel=1e-4)


def test_a_cubic_in_parameters_goes_through_its_ends() -> None:
    piece = Cubic(2.0, (5.0, 6.0), np.pi / 2, 10.0, np.array([0, 12.0, 0, -2.0]), np.array([0, 0, 3.0, -1.0]), 0.1)
    found, headings = piece.at(np.array([2.0, 12.0]))
    np.testing.assert_allclose(found, [[5.0, 6.0], [5.0 - 2.0, 6.0 + 10.0]], atol=1e-12)
    np.testing.assert_allclose(headings, [np.pi / 2, np.pi / 2 + np.arctan2(3.0, 6.0)], atol=1e-12)


def test_beside_a_line_is_to_its_left() -> None:
    line = ReferenceLine(
        (Bend(0.0, (0.0, 0.0), 0.0, 10.0, 0.0, 0.0), Bend(10.0, (10.0, 0.0), np.pi / 2, 5.0, 0.0, 0.0))
    )
    found = line.beside(np.array([4.0, 12.0]), np.array([2.0, 1.0]))
    np.testing.assert_allclose(found, [[4.0, 2.0], [9.0, 2.0]], atol=1e-12)


@fuzz
@given(st.floats(5.0, 150.0), CURVATURE, CURVATURE, st.floats(-8.0, 8.0))
def test_chords_stay_near_the_curve(length: float, first: float, last: float, side: float) -> None:
    line = ReferenceLine((Bend(0.0, (0.0, 0.0), 0.5, length, first, (last - first) / length),))

    def curve(s: FloatArray) -> FloatArray:
        return line.beside(s, np.full(len(s), side))

    points = polyline(curve, np.array([0.0, length]))
    fine = curve(np.linspace(0.0, length, 2000))
    starts, chords = points[:-1], np.diff(points, axis=0)
    share = ((fine[:, None] - starts) * chords).sum(axis=2) / np.maximum((chords**2).sum(axis=1), 1e-12)
    nearest = starts + np.clip(share, 0, 1)[..., None] * chords
    assert np.linalg.norm(fine[:, None] - nearest, axis=2).min(axis=1).max() < CHORD_M
    np.testing.assert_allclose(points[[0, -1]], fine[[0, -1]], atol=1e-9)


def test_what_no_road_is_is_refused() -> None:
    with pytest.raises(GeometryError, match="turns by 1000 rad"):
        Bend(0.0, (0.0, 0.0), 0.0, 1000.0, 1.0, 0.0).at(np.zeros(1))
    with pytest.raises(GeometryError, match=r"is 1e\+09 m long"):
        polyline(lambda s: np.column_stack([s, s]), np.array([0.0, 1e9]))
    with pytest.raises(GeometryError, match="is too crooked"):
        polyline(lambda s: np.column_stack([s, 50.0 * np.sin(997.0 * s)]), np.array([0.0, 9e5]))
