"""What a body tells of whose it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.frames import rotate_xy
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.resemblance import resemblance
from laci_stereo.core.tracking import Track
from tests.core.outlines import HEIGHT_M, SIZE, TRUTH, evidence
from tests.core.tracks import sighting

DRIVE = evidence(sigma_m=0.03, behind=0.1)


def seen() -> Track:
    """The evidence as the track that it was collected from."""
    sightings = []
    for number, stamp_s in enumerate(DRIVE.stamps_s):
        of_frame = DRIVE.frame == number
        points = DRIVE.points[of_frame]
        sightings.append(
            replace(
                sighting(float(stamp_s), DRIVE.middles[number], count=len(points)),
                points=points,
                sigma_along_m=DRIVE.sigma_along_m[of_frame],
                sigma_across_m=DRIVE.sigma_across_m[of_frame],
            )
        )
    return Track(tuple(sightings))


def odds(length_m: float, clock_s: float = 0.0, start: PlanarMatch = TRUTH) -> float:
    vehicle = DRIVE.vehicle
    told = replace(vehicle, length_m=length_m, stamps_s=vehicle.stamps_s + clock_s)
    return resemblance(seen(), told, start, 0.0, HEIGHT_M)


def test_a_body_of_the_length_that_was_told_speaks_for_its_sender() -> None:
    # A stranger would be within the doubt of 0.1 m by one chance in three or less.
    assert odds(SIZE[0]) > np.log(3.0)


@pytest.mark.parametrize("off_m", [-0.9, 0.6, 1.5])
def test_a_body_of_another_length_speaks_against_it(off_m: float) -> None:
    assert odds(SIZE[0] + off_m) < -2.0


def test_the_start_need_not_be_exact() -> None:
    middle = DRIVE.middles.mean(axis=0)
    yaw = TRUTH.yaw_rad + np.radians(3.0)
    start = PlanarMatch(yaw, TRUTH(middle[None])[0] + np.array([0.5, -0.4]) - rotate_xy(yaw, middle))
    assert odds(SIZE[0], start=start) == pytest.approx(odds(SIZE[0]), abs=0.2)


def test_a_clock_that_contradicts_speaks_against_it() -> None:
    # The turn tells time: a third of a second is beyond what clocks that agree to 10 ms can be.
    assert odds(SIZE[0], clock_s=0.3) < odds(SIZE[0]) - 2.0


def test_what_shows_no_body_tells_nothing() -> None:
    bare = Track(tuple(replace(one, points=np.zeros((0, 3)), sigma_along_m=np.zeros(0), sigma_across_m=np.zeros(0))
                       for one in seen().sightings))  # fmt: skip
    assert resemblance(bare, DRIVE.vehicle, TRUTH, 0.0, HEIGHT_M) == 0.0
