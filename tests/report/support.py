"""A calibration without error, made by hand: a camera looks north over a road on which a car turns left."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.frames import OPENCV_AXES, Axes, FloatArray, invert, planar, rotate_xy, transform
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.result import Calibration, Quality
from laci_stereo.core.settings import SYNCHRONISED_S
from laci_stereo.core.tracking.background import Background, BackgroundBox
from laci_stereo.core.tracking.box import Box
from laci_stereo.core.tracking.sighting import Sighting
from laci_stereo.core.tracking.tracks import Track
from laci_stereo.core.world import World
from laci_stereo.io.maps.lane_map import LaneLine, LaneMap
from laci_stereo.io.rig.stereo_rig import Lens

SENSOR_XY = np.array([3.0, -4.0])
YAW_RAD = np.radians(90.0)
TILT_RAD = np.radians(15.0)
HEIGHT_M = 6.0
LENGTH_M, WIDTH_M = 4.5, 1.8
SPEED_MPS = 8.0
CORNER = np.array([3.0, 20.0])
BESIDE_M = np.array([-3.0, 3.5])


def calibration(axes: Axes = OPENCV_AXES, far_box: bool = False) -> Calibration:
    ground = GroundPlane(
        normal=np.cos(TILT_RAD) * np.array(axes.up) - np.sin(TILT_RAD) * np.array(axes.forward),
        height_m=HEIGHT_M,
        covariance_sensor=np.eye(4) * 1e-8,
        inlier_share=0.9,
        support_cells=1000,
        support_share=0.9,
        support_area_m2=500.0,
        unevenness_m=0.01,
    )
    T_level_sensor = ground.T_level_sensor(axes)
    T_world_level = planar(YAW_RAD, SENSOR_XY)
    stamps_s = np.arange(0.0, 5.01, 0.1)
    xy, yaw = drive(stamps_s)
    vehicle = VehicleTrack(stamps_s, 1_700_000_000_000_000_000, xy, yaw, LENGTH_M, WIDTH_M)
    sightings = tuple(sighting(t, T_world_level) for t in stamps_s[10:41])
    boxes = [BackgroundBox(Box(np.array([25.0, 8.0]), 6.0, 4.0, 0.3), 3.0)]
    if far_box:
        boxes.append(BackgroundBox(Box(np.array([120.0, -30.0]), 6.0, 4.0, 0.3), 3.0))
    covariance = np.diag([1e-4, 1e-4, 4e-4, 0.09, 0.04, 1e-4])
    passage = Passage(
        world=World("EPSG:32632", (569797.0, 5363703.0), 0.99966),
        axes=axes,
        ground=ground,
        background=Background(tuple(boxes), 5, 0.2),
        track=Track(sightings),
        vehicle=vehicle,
        station_id=4711,
        match=PlanarMatch(float(YAW_RAD), SENSOR_XY),
        time_offset_s=0.0,
        method="paper",
        clock_sigma_s=SYNCHRONISED_S,
    )
    return Calibration(
        passages=(passage,),
        T_world_sensor=T_world_level @ T_level_sensor,
        T_level_sensor=T_level_sensor,
        covariance=covariance,
        centre_world=np.append(xy[10:41].mean(axis=0), 0.0),
        time_sigma_s=0.01,
        paper=PlanarMatch(float(YAW_RAD) + 0.01, SENSOR_XY),
        quality=Quality("pass", (), 0.36, 0.3, 90.0, "", 1.1, 0.01, 0.01, 0.05, 31, 31, {}),
    )


def with_drive(true: Calibration, **changes: Any) -> Calibration:
    """Return a calibration whose own drive is another."""
    return replace(true, passages=(replace(true.drive, **changes), *true.others))


def with_another(true: Calibration) -> Calibration:
    """Return a calibration from a second drive as well, of a car that drives beside the first."""
    (own,) = true.passages
    beside = rotate_xy(-YAW_RAD, BESIDE_M)
    track = Track(
        tuple(
            replace(one, middle=one.middle + beside, box=replace(one.box, centre=one.box.centre + beside))
            for one in own.track.sightings
        )
    )
    vehicle = replace(own.vehicle, xy=own.vehicle.xy + BESIDE_M)
    return replace(true, passages=(own, replace(own, track=track, vehicle=vehicle, station_id=4712)))


def drive(stamps_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """To the east until the corner at 2.5 s, then to the north; shapes (n, 2) and (n,)."""
    ahead = SPEED_MPS * (stamps_s - 2.5)
    east, north = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    xy = CORNER + np.outer(np.minimum(ahead, 0.0), east) + np.outer(np.maximum(ahead, 0.0), north)
    return xy, np.where(ahead < 0.0, 0.0, np.pi / 2)


def sighting(stamp_s: float, T_world_level: FloatArray) -> Sighting:
    xy, yaw = drive(np.array([stamp_s]))
    level = transform(invert(T_world_level), np.append(xy[0], 0.0)[None])[0, :2]
    yaw_level = (yaw[0] - YAW_RAD + np.pi / 2) % np.pi - np.pi / 2
    box = Box(level, LENGTH_M, WIDTH_M, float(yaw_level))
    points = np.column_stack([box.corners(), np.full(4, 1.4)])
    exact = np.zeros(len(points))
    return Sighting(float(stamp_s), float(stamp_s), points, exact, exact, 4, level, box, None)


def lens(width: int = 1280, height: int = 720, distortion: FloatArray | None = None) -> Lens:
    focal = 0.8 * width
    K = np.array([[focal, 0.0, (width - 1) / 2], [0.0, focal, (height - 1) / 2], [0.0, 0.0, 1.0]])
    return Lens(K, np.zeros(5) if distortion is None else distortion, (width, height), "pinhole")


def pixel(point_world: tuple[float, float, float], lens: Lens) -> tuple[int, int]:
    """Column and row of a point by the pinhole formula: the camera looks to grid north and down."""
    right = point_world[0] - SENSOR_XY[0]
    north, below = point_world[1] - SENSOR_XY[1], HEIGHT_M - point_world[2]
    depth = north * np.cos(TILT_RAD) + below * np.sin(TILT_RAD)
    down = below * np.cos(TILT_RAD) - north * np.sin(TILT_RAD)
    u = lens.K[0, 0] * right / depth + lens.K[0, 2]
    v = lens.K[1, 1] * down / depth + lens.K[1, 2]
    return round(float(u)), round(float(v))


def lane_map(*lines: LaneLine) -> LaneMap:
    return LaneMap(lines, ())


def lane(*xy: tuple[float, float], kind: str = "line_thin", subtype: str = "solid") -> LaneLine:
    return LaneLine(kind, subtype, np.array(xy), "1")
