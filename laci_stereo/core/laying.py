"""What was seen in the level frame of one ground, laid into that of another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from laci_stereo.core.background import Background
from laci_stereo.core.box import Box
from laci_stereo.core.frames import FloatArray, transform, wrap
from laci_stereo.core.tracking import Track


def laid_xy(T_a_b: FloatArray, xy: FloatArray) -> FloatArray:
    """Return places on the ground of b, shape (n, 2), on the ground plan of a."""
    return transform(T_a_b, np.column_stack([xy, np.zeros(len(xy))]))[:, :2]


def laid_track(T_a_b: FloatArray, track: Track) -> Track:
    """Return a track in the level frame of a."""
    return Track(
        tuple(
            replace(
                sighting,
                points=transform(T_a_b, sighting.points),
                low=replace(sighting.low, points=transform(T_a_b, sighting.low.points)),
                borders=transform(T_a_b, sighting.borders),
                middle=laid_xy(T_a_b, sighting.middle[None])[0],
                box=_laid_box(T_a_b, sighting.box),
            )
            for sighting in track.sightings
        )
    )


def laid_background(T_a_b: FloatArray, background: Background) -> Background:
    """Return a background in the level frame of a."""
    boxes = tuple(replace(static, box=_laid_box(T_a_b, static.box)) for static in background.boxes)
    return replace(background, boxes=boxes)


def _laid_box(T_a_b: FloatArray, box: Box) -> Box:
    turned = 2 * (box.yaw_rad + np.arctan2(T_a_b[1, 0], T_a_b[0, 0]))
    return replace(box, centre=laid_xy(T_a_b, box.centre[None])[0], yaw_rad=float(wrap(turned)) / 2)
