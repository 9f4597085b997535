"""Lane check of a camera: compares the map with the median of some of its images, which shows the road at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from laci_stereo.check.lanes import MAP_SIGMA_M, LaneCheck, check_lanes
from laci_stereo.check.picture import draw_check
from laci_stereo.check.placed import Placed
from laci_stereo.check.profiles import profiles_in_image
from laci_stereo.check.ridges import find_stripes
from laci_stereo.check.sections import Sections
from laci_stereo.check.traces import Traces
from laci_stereo.core.errors import ImageError
from laci_stereo.core.frames import Raster, invert
from laci_stereo.core.subsampling import spread
from laci_stereo.io.maps.lane_map import LaneMap
from laci_stereo.io.rig.stereo_rig import Lens
from laci_stereo.report.camera import Camera
from laci_stereo.report.drawn import on_ground
from laci_stereo.stereo.reader import GreyReader

FRAMES = 15
"""Number of images, uniformly spaced: what covers a place in fewer than half of them does not appear in their
median."""


@dataclass(frozen=True)
class Checked:
    """A check and the picture of it."""

    check: LaneCheck
    picture: Raster


def check_images(
    files: Sequence[Path],
    reader: GreyReader,
    lens: Lens,
    placed: Placed,
    lane_map: LaneMap,
    map_sigma_m: float = MAP_SIGMA_M,
) -> Checked:
    """Compare a map with what a camera saw.

    Parameters
    ----------
    files : sequence of Path
        Raw images in order of time.
    reader : GreyReader
    lens : Lens
    placed : Placed
    lane_map : LaneMap
    map_sigma_m : float
        Standard deviation of a line's position in the map.

    Raises
    ------
    ImageError
        If more than a fifth of the selected images cannot be read.
    """
    image = at_rest(files, reader)
    camera = Camera(lens, invert(placed.T_world_sensor))
    check = check_lanes(lane_map.lines, placed, partial(paint_in_image, image, camera), map_sigma_m)
    picture = draw_check(image, lambda xy: camera.project_line(on_ground(xy)), check, placed, lane_map)
    return Checked(check, picture)


def paint_in_image(image: Raster, camera: Camera, sections: Sections) -> Traces:
    """Detect paint across sections of lines in an image, raw, grey, shape (height, width)."""
    return find_stripes(profiles_in_image(image, camera, sections), sections.line)


def at_rest(files: Sequence[Path], reader: GreyReader) -> Raster:
    """Return the median of some images: grey, uint8, without moving objects.

    Raises
    ------
    ImageError
        If more than a fifth of them cannot be read.
    """
    chosen = spread(files, FRAMES)
    reader.eight_bit.learn_from(chosen)
    read = [image for image in map(reader.read, chosen) if image is not None]
    reader.check([(path,) for path in chosen])
    if not read:
        raise ImageError("0 images; needed is at least one")
    median: Raster = np.median(np.stack(read), axis=0).astype(np.uint8)
    return median
