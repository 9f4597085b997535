"""Another focal length or baseline is told where nothing fits as it was seen."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from laci_stereo.core.association.case import Case
from laci_stereo.core.association.wrong_optics import STEP, disparities_off, optics_off
from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.errors import MatchError
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking.reframing import nearer_track, stretched_track
from laci_stereo.core.tracking.tracks import Track
from tests.core.tracks import seen, sighting, vehicle
from tests.simulated import LEFT_TURN, Recording, scene, stereo

TOLD = re.compile(
    r"if the stereo camera's (focal length|baseline) were (\d+) % (longer|shorter) than its calibration has it, "
    r"station 42 would match its messages: is that the calibration of these images\?"
)


def by_a_matcher(track: Track) -> Track:
    return Track(tuple(replace(sighting, window_rad=0.01) for sighting in track.sightings))


def said(track: Track) -> str:
    told = optics_off(Case([track], {42: vehicle()}, MatchSettings()))
    return told.words if told else ""


@pytest.mark.parametrize("by", [0.55, 0.9, 1.3, *(pytest.param(by, marks=pytest.mark.slow) for by in (0.8, 1.1, 1.9))])
@pytest.mark.parametrize("what", ["focal length", "baseline"])
def test_by_how_much_what_is_wrong_is_told(what: str, by: float) -> None:
    measured = stretched_track(by_a_matcher(seen()), 1.0 / by, 1.0 / by if what == "baseline" else 1.0)
    told = TOLD.fullmatch(said(measured))
    assert told is not None
    assert told[1] == what
    assert told[3] == ("longer" if by > 1.0 else "shorter")
    assert float(told[2]) / 100.0 == pytest.approx(abs(by - 1.0), abs=STEP * by)


def test_of_what_fits_as_it_was_seen_nothing_is_said() -> None:
    assert said(by_a_matcher(seen())) == ""


def test_what_no_matcher_saw_has_no_optics() -> None:
    assert said(stretched_track(seen(), 0.8, 0.8)) == ""


@pytest.mark.parametrize(
    "per_m", [-0.012, 0.004, *(pytest.param(per_m, marks=pytest.mark.slow) for per_m in (-0.004, 0.008))]
)
def test_an_offset_of_all_disparities_is_told(per_m: float) -> None:
    """Inverse distances are too small by it, so larger ones would fit."""
    measured = nearer_track(by_a_matcher(seen()), -per_m)
    told = disparities_off(Case([measured], {42: vehicle()}, MatchSettings()))
    assert told is not None
    assert "station 42 would match its messages: has one of the cameras yawed" in told.words
    typical_m = float(np.median(np.linalg.norm(measured.centres, axis=1)))
    assert told.nearer_per_m * typical_m == pytest.approx(per_m * typical_m, abs=STEP * (1.0 + abs(per_m) * typical_m))


def test_a_track_whose_inverse_distances_are_larger() -> None:
    one = sighting(0.0, np.array([20.0, 5.0]), yaw_rad=0.3)
    one = replace(one, borders=np.array([[19.0, 4.0, 1.0], [21.0, 6.0, 1.0]]))
    (other,) = nearer_track(Track((one,)), 0.01).sightings
    moved = [(one.points, other.points), (one.borders, other.borders), (one.middle[None], other.middle[None])]
    for before, after in moved:
        (inverse, expected) = (1.0 / np.linalg.norm(xyz[:, :2], axis=1) for xyz in (after, before))
        np.testing.assert_allclose(inverse, expected + 0.01)
        np.testing.assert_allclose(np.arctan2(*after[:, :2].T), np.arctan2(*before[:, :2].T))
        np.testing.assert_allclose(after[:, 2:], before[:, 2:])
    (back,) = nearer_track(Track((other,)), -0.01).sightings
    np.testing.assert_allclose(back.points, one.points)
    np.testing.assert_allclose(back.sigma_along_m, one.sigma_along_m)
    np.testing.assert_allclose(back.box.centre, one.box.centre)


@pytest.mark.parametrize(("ahead", "aside"), [(1.2, 1.2), (1.2, 1.0), (0.7, 1.0)])
def test_a_stretched_track(ahead: float, aside: float) -> None:
    one = sighting(0.0, np.array([20.0, 5.0]), yaw_rad=0.3)
    one = replace(one, borders=np.array([[19.0, 4.0, 1.0], [21.0, 6.0, 1.0]]))
    (other,) = stretched_track(Track((one,)), ahead, aside).sightings
    over = np.array([ahead, aside, aside])
    np.testing.assert_allclose(other.box.centre, one.box.centre * over[:2])
    np.testing.assert_allclose(other.points, one.points * over)
    np.testing.assert_allclose(other.borders, one.borders * over)
    assert other.box.length_m >= other.box.width_m
    if ahead == aside:
        np.testing.assert_allclose(other.box.corners(), one.box.corners() * over[:2])


def test_a_stretched_box_has_its_longer_side_along() -> None:
    across = sighting(0.0, np.array([20.0, 5.0]), yaw_rad=np.pi / 2)
    (other,) = stretched_track(Track((across,)), 4.0, 1.0).sightings
    assert (other.box.length_m, other.box.width_m) == pytest.approx((4.0 * 1.8, 4.4))
    assert abs(np.sin(other.box.yaw_rad)) < 1e-9
    corners = across.box.corners() * [4.0, 1.0]
    np.testing.assert_allclose(sorted(other.box.corners().round(9).tolist()), sorted(corners.round(9).tolist()))


@dataclass(frozen=True)
class TooShort(Recording):
    """A recording whose stereo calibration has the focal length 20 % too short."""

    def frame(self, index: int) -> PointCloud:
        cloud = super().frame(index)
        return replace(cloud, points=cloud.points * [1.0, 1.0, 0.8])


@pytest.mark.slow
def test_a_focal_length_that_is_far_off_is_named_where_nothing_fits() -> None:
    made = scene(LEFT_TURN, stereo(window_px=5))
    right = made.recording
    wrong = TooShort(right.sensor, right.T_world_sensor, right.static, right.movers, right.times_s)
    told = r"camera's focal length were 2\d % longer than its calibration has it, station \d+"
    with pytest.raises(MatchError, match=told):
        calibrate(wrong, made.messages)
