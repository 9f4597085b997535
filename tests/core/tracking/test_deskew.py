"""What was taken of a vehicle one after the other is brought to one time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.settings import Settings
from laci_stereo.core.tracking.deskew import deskewed
from laci_stereo.core.tracking.sighting import box_around
from laci_stereo.core.tracking.tracks import Track
from tests.core.tracks import sighting

SETTINGS = Settings()
PERIOD_S = 0.5
LENGTH_M, WIDTH_M = 4.4, 1.8


def body(stamps_s: FloatArray, speed_mps: float, radius_m: float) -> tuple[FloatArray, FloatArray]:
    """Return where the middle of a vehicle on a circle about the origin is, shape (n, 2), and its yaw."""
    angle = stamps_s * speed_mps / radius_m
    return radius_m * np.column_stack([np.cos(angle), np.sin(angle)]), angle + np.pi / 2


def outline() -> FloatArray:
    """Return points all around a vehicle's outline, shape (200, 2), vehicle frame, in no order of place."""
    t = np.linspace(-0.5, 0.5, 50, endpoint=False)
    end, side = np.full(50, LENGTH_M / 2), np.full(50, WIDTH_M / 2)
    x = np.concatenate([end, -end, LENGTH_M * t, LENGTH_M * t])
    y = np.concatenate([WIDTH_M * t, WIDTH_M * t, side, -side])
    return np.random.default_rng(7).permutation(np.column_stack([x, y]))


def seen(speed_mps: float, radius_m: float, span_s: float) -> Track:
    """The vehicle in ten frames, each gathered over a span."""
    sightings = []
    for stamp_s in PERIOD_S * np.arange(10):
        late_s = np.linspace(-span_s / 2, span_s / 2, 200)
        xy, yaw_rad = body(stamp_s + late_s, speed_mps, radius_m)
        points = np.column_stack([xy + rotate_xy(yaw_rad, outline()), np.full(200, 0.5)])
        noise = np.zeros(200)
        sightings.append(
            replace(
                sighting(float(stamp_s), np.median(points[:, :2], axis=0)),
                points=points,
                sigma_along_m=noise,
                sigma_across_m=noise,
                box=box_around(points, SETTINGS),
                late_s=late_s,
            )
        )
    return Track(tuple(sightings))


@pytest.mark.parametrize(
    ("speed_mps", "radius_m", "span_s"),
    [(10.0, 1e4, 0.5), (10.0, 15.0, 0.4), (4.0, -8.0, 0.5), (20.0, 1e4, 0.02)],
    ids=["straight, gathered", "left turn, gathered", "right turn, gathered", "one sweep past a fast car"],
)
def test_points_are_where_they_were_at_the_stamp(speed_mps: float, radius_m: float, span_s: float) -> None:
    track = seen(speed_mps, radius_m, span_s)
    still = deskewed(track, SETTINGS)
    for before, after in zip(track.sightings[2:-2], still.sightings[2:-2], strict=True):
        xy, yaw_rad = body(np.array([after.stamp_s]), speed_mps, radius_m)
        truth = xy + rotate_xy(yaw_rad[0], outline())
        smear_m, rest_m = (np.linalg.norm(one.points[:, :2] - truth, axis=1).max() for one in (before, after))
        assert rest_m < 0.1 * smear_m
        assert abs(after.box.length_m - LENGTH_M) < 0.1 * abs(before.box.length_m - LENGTH_M)
        assert after.late_s is None


def test_what_stands_stays_where_it_is() -> None:
    track = seen(0.0, 10.0, 0.5)
    for before, after in zip(track.sightings, deskewed(track, SETTINGS).sightings, strict=True):
        np.testing.assert_array_equal(after.points, before.points)
