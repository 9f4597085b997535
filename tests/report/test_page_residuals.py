"""The residuals of the report page, against drives whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.settings import JointSettings
from laci_stereo.core.tracking.reframing import moved_vehicle, reported_on_map
from laci_stereo.report.page.charts import Series, chart
from laci_stereo.report.page.residuals import Fit, centre_offsets, fit_drive, median_by_frame
from laci_stereo.report.topdown import position_covariance
from tests.passages import DRIVES, recorded
from tests.report.page_support import points_of
from tests.report.support import calibration


def fitted(number: int = 0, settings: JointSettings | None = None, **changes: object) -> Fit:
    passage = replace(recorded()[number][1].passages[0], **changes)
    fit = fit_drive(passage, settings or JointSettings())
    assert fit is not None
    return fit


def correction(fit: Fit, what: str) -> float:
    (found,) = (each.value for each in fit.corrections if each.what == what)
    return found


@pytest.mark.parametrize("number", [pytest.param(0, marks=pytest.mark.slow), 1, 2])
def test_the_residuals_are_the_estimates_own(number: int) -> None:
    laid = fitted(number).laid
    assert laid is not None
    rms_m = np.sqrt(np.average(laid.distance_m**2, weights=laid.surface))
    assert rms_m == pytest.approx(recorded()[number][1].quality.residual_rms_m, rel=0.02)


@pytest.mark.parametrize("number", range(3))
def test_the_clock_is_the_estimates_own(number: int) -> None:
    found = recorded()[number][1]
    assert correction(fitted(number), "clock") == pytest.approx(found.drive.time_offset_s, abs=0.2 * found.time_sigma_s)


@pytest.mark.parametrize("number", range(3))
def test_points_lie_on_the_sides_of_the_true_vehicle(number: int) -> None:
    laid = fitted(number).laid
    assert laid is not None
    _, length, width = DRIVES[number]
    for faces, axis, extent in (((0, 1), 0, length), ((2, 3), 1, width)):
        of_side = laid.xy_vehicle[np.isin(laid.face, faces) & (laid.surface > 0.5), axis]
        # Noise is 2 cm, and the body's model stands 1.5 cm back where the simulated box does not.
        assert abs(np.median(np.abs(of_side)) - extent / 2) < 0.03


def test_what_lies_outside_has_a_positive_distance() -> None:
    laid = fitted().laid
    assert laid is not None
    outwards = np.array([-1.0, 1.0, -1.0, 1.0])
    for face in range(4):
        chosen = (laid.face == face) & (laid.surface > 0.5)
        if chosen.sum() > 20:
            place = outwards[face] * laid.xy_vehicle[chosen, 0 if face < 2 else 1]
            assert np.corrcoef(place, laid.distance_m[chosen])[0, 1] > 0.5


@pytest.mark.parametrize("late_s", [-0.2, 0.3])
def test_late_messages_are_told_by_the_clock(late_s: float) -> None:
    passage = recorded()[0][1].passages[0]
    late = replace(passage.vehicle, stamps_s=passage.vehicle.stamps_s + late_s)
    loose = JointSettings(clock_sigma_s=1.0)
    before = correction(fitted(settings=loose), "clock")
    assert correction(fitted(settings=loose, vehicle=late), "clock") == pytest.approx(before + late_s, abs=0.01)


@pytest.mark.parametrize("off_deg", [-8.0, 8.0])
def test_wrong_headings_are_told(off_deg: float) -> None:
    """Heavy tails of the priors let the points prevail."""
    passage = recorded()[0][1].passages[0]
    xy, yaw_rad = reported_on_map(passage.vehicle)
    turned = moved_vehicle(passage.vehicle, xy, yaw_rad - np.radians(off_deg), None)
    assert correction(fitted(vehicle=turned), "heading") == pytest.approx(np.radians(off_deg), abs=np.radians(1.0))


def test_boxes_without_points_have_corrections_but_no_outline() -> None:
    passage = recorded()[0][1].passages[0]
    none = np.zeros((0, 3))
    bare = [
        replace(each, points=none, sigma_along_m=none[:, 0], sigma_across_m=none[:, 0], late_s=None)
        for each in passage.track.sightings
    ]
    fit = fitted(track=replace(passage.track, sightings=tuple(bare)))
    assert fit.laid is None
    assert len(fit.corrections) == 7


def test_no_message_at_the_time_is_no_fit() -> None:
    passage = recorded()[0][1].passages[0]
    away = replace(passage.vehicle, stamps_s=passage.vehicle.stamps_s + 1000.0)
    assert fit_drive(replace(passage, vehicle=away), JointSettings()) is None


def test_centres_are_compared_in_the_vehicles_axes() -> None:
    exact = calibration().passages[0]
    for ahead_m, left_m in ((0.0, 0.0), (0.7, 0.0), (0.0, -0.4)):
        yaw = exact.vehicle.yaw_rad
        shift = ahead_m * np.column_stack([np.cos(yaw), np.sin(yaw)]) + left_m * np.column_stack(
            [-np.sin(yaw), np.cos(yaw)]
        )
        apart = centre_offsets(replace(exact, vehicle=replace(exact.vehicle, xy=exact.vehicle.xy - shift)))
        still = np.abs(apart.stamps_s - 2.5) > 0.3  # at the corner the yaw jumps
        np.testing.assert_allclose(apart.ahead_m[still], ahead_m, atol=1e-6)
        np.testing.assert_allclose(apart.left_m[still], left_m, atol=1e-6)


def test_frames_have_their_quartiles() -> None:
    stamps, quartiles = median_by_frame(np.array([2.0, 1.0, 1.0, 1.0, 1.0, 1.0]), np.array([7.0, 5, 4, 3, 2, 1]))
    assert stamps.tolist() == [1.0, 2.0]
    assert quartiles.tolist() == [[2.0, 3.0, 4.0], [7.0, 7.0, 7.0]]


def test_marks_of_a_chart_are_where_its_ticks_say() -> None:
    x, y = np.array([0.0, 4.0, 10.0]), np.array([-20.0, 30.0, 10.0])
    laid = chart("t", "x", "y", [Series("ends", "a", x, y, y - 5.0, y + 5.0)])

    def at(ticks: tuple[object, ...], values: np.ndarray) -> np.ndarray:
        places = np.array([tick.at for tick in ticks])  # type: ignore[attr-defined]
        numbers = np.array([float(tick.text.replace("−", "-")) for tick in ticks])  # type: ignore[attr-defined]
        slope, offset = np.polyfit(numbers, places, 1)
        return slope * values + offset

    bars = points_of(laid.series[0].bars).reshape(3, 2, 2)
    np.testing.assert_allclose(bars[:, 0, 0], at(laid.x_ticks, x), atol=0.1)
    np.testing.assert_allclose(bars[:, 0, 1], at(laid.y_ticks, y - 5.0), atol=0.1)
    np.testing.assert_allclose(bars[:, 1, 1], at(laid.y_ticks, y + 5.0), atol=0.1)
    assert laid.zero == pytest.approx(float(at(laid.y_ticks, np.zeros(1))[0]))
    assert laid.bottom > bars[:, :, 1].max() > bars[:, :, 1].min() > laid.top


def test_the_doubt_of_the_sensors_place_is_that_of_its_transform() -> None:
    rng = np.random.default_rng(3)
    true = calibration()
    root = np.diag([0.01, 0.02, 0.03, 0.1, 0.2, 0.1])
    covariance = root @ (np.eye(6) + 0.3) @ root
    true = replace(true, covariance=covariance)
    at = true.T_world_sensor[:3, 3]
    drawn = rng.multivariate_normal(np.zeros(6), covariance, 200_000)
    moved = np.cross(drawn[:, :3], at - true.centre_world) + drawn[:, 3:]
    np.testing.assert_allclose(position_covariance(true, at[:2], at[2]), np.cov(moved[:, :2].T), rtol=0.03, atol=1e-3)
