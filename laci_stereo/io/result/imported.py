"""Transforms of other tools, imported as results of this project, with null for what they leave unknown."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from pyproj import Transformer

from laci_stereo.core.errors import CalibrationFileError, SettingError
from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, OPENCV_AXES, FloatArray, invert
from laci_stereo.core.result import viewing_angles
from laci_stereo.core.world import World, utm_code
from laci_stereo.io.file_content import read_content
from laci_stereo.io.output import RESULT_FILE
from laci_stereo.io.result.calibration_file import Document, beginning, validate
from laci_stereo.io.result.siting import Siting, Statement, rigid_in_grid
from laci_stereo.io.result.written_pose import WrittenPose, read_pose
from laci_stereo.io.rig.stereo_rig import RAW_FRAME, RECTIFIED_FRAME
from laci_stereo.io.text_file import quoted, shortened

HIGHEST_M = 100.0
"""Largest height of a sensor above the ground: the tallest masts beside roads have half of it, so a greater value is in
another unit, or an altitude."""

MOST_UP_DEG = 45.0
"""Largest elevation of a camera's line of sight: beyond it, no lens with a field of view of 90 deg sees the ground. A
camera tilted down by 0 to 35 deg appears to look 55 to 90 deg up if its pose is that of axes with x forward, z up."""

MOST_ROLLED_DEG = 45.0
"""Largest roll of a sensor that needs no warning. Brackets hold sensors upright, upside down or on their side, out of
true by a few degrees: halfway between these, neither is meant. For a LiDAR it is the angle of its vertical axis to the
plumb line, whichever end is up; of a camera that looks down by more than `STEEP_DEG` the roll has no meaning."""

LEVEL_DEG = 5.0
"""Largest elevation of a camera's line of sight that needs no warning: the steepest main roads climb by 8 %, 4.6 deg,
so a camera that looks farther up has no road in the middle of its image, whichever way the road goes."""

STEEP_DEG = 80.0
"""Largest tilt down of a camera at which it has an upper side: steeper, an error of 10 deg, more than brackets have,
turns it past the vertical, where what was up is down."""

FARTHEST_CENTRE_M = 1000.0
"""Largest distance of the centre from the sensor, which sees no farther; over this distance, the grid scale makes a
difference of 0.4 m."""

DAIR_WORLD, DAIR_CAMERA = "virtuallidar_to_world.json", "virtuallidar_to_camera.json"

_KIND_AXES = {"stereo": OPENCV_AXES, "lidar": FORWARD_LEFT_UP_AXES, "detections": FORWARD_LEFT_UP_AXES}
_KIND_FRAMES = {"stereo": RAW_FRAME, "lidar": "as in the scans"}

Direction = Literal["sensor-to-map", "map-to-sensor"]


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """A user's statements about a transform of another tool.

    Attributes
    ----------
    kind : str or None
        Of the sensor: stereo or lidar; None: as the file states.
    crs : str or None
        The UTM zone of the map; None: as the file states.
    origin : tuple of float or None
        UTM east and north of the map frame's origin, and the ground's z in the map; None: as the file states, else
        zeros.
    direction : str or None
        Direction of the transform; None: as names and frames in the file imply, or the one that is possible.
    centre : tuple of float or None
        UTM east and north at which the rigid transform is true to scale; None: as the file states, or at the sensor.
    rectified : bool
        Whether it is the pose of a camera for already rectified images; an export of this project states that itself.
    name : str or None
    entry : str or None
        Name of the transform, if the file holds several.
    form : str or None
        Format of the file; None: recognised by its content.
    """

    kind: str | None = None
    crs: str | None = None
    origin: tuple[float, ...] | None = None
    direction: Direction | None = None
    centre: tuple[float, float] | None = None
    rectified: bool = False
    name: str | None = None
    entry: str | None = None
    form: str | None = None


@dataclass(frozen=True)
class Imported:
    """A transform of another tool in our frames, with notes on its interpretation."""

    siting: Siting
    notes: tuple[str, ...]


def import_pose(path: Path, options: ImportOptions) -> Imported:
    """Read a transform that another tool wrote, in a file or in a folder with DAIR-V2X's two files of a camera.

    Raises
    ------
    CalibrationFileError
        If the file cannot be read, holds no rigid transform, or puts the sensor at an impossible position.
    SettingError
        If neither the file nor the options state a required quantity, or they contradict each other.
    """
    pose, statement = _read(path, options)
    kind = _said(
        "the sensor's kind", "--kind stereo or lidar", options.kind, statement.kind if statement else None, path
    )
    if kind not in _KIND_AXES:
        raise CalibrationFileError(f"{path}: the sensor's kind is {quoted(kind)}; needed is {', '.join(_KIND_AXES)}")
    stated_crs = statement.world.crs if statement else None
    crs = utm_code(shortened(_said("its UTM zone", "--crs EPSG:326..", options.crs, stated_crs, path)))
    if statement is not None and pose.from_map is None:  # in our other exports, a name states the direction
        pose = replace(pose, from_map=False)
    T_map_sensor, direction_note = _towards_map(path, pose, options, kind)
    T_utm_sensor, local = _in_utm(path, T_map_sensor, options.origin, statement)
    _check_place(path, T_utm_sensor, statement)
    unusual = _check_mounting(path, T_utm_sensor, kind, ours=statement is not None)
    world = _world(crs, T_utm_sensor, statement)
    world = world if pose.grid_scale is None else replace(world, grid_scale=pose.grid_scale)
    siting = Siting(
        options.name or (statement.name if statement else path.absolute().stem),
        kind,
        _frame(path, kind, statement.frame if statement else None, options.rectified),
        world,
        *_in_world(world, T_utm_sensor, pose.grid_scale, _centre(world, T_utm_sensor, options.centre, statement)),
    )
    notes = (f"transform {pose.name} of {path.name}, {direction_note}", *local, *pose.notes, *unusual)
    return Imported(siting, notes)


def _read(path: Path, options: ImportOptions) -> tuple[WrittenPose, Statement | None]:
    if not path.is_dir():
        _check_foreign(path, path)
        return read_pose(path, options.entry, options.form)
    if not (path / DAIR_WORLD).exists():
        _check_foreign(path, path / RESULT_FILE)
    world, statement = read_pose(path / DAIR_WORLD, options.entry, options.form)
    camera, _ = read_pose(path / DAIR_CAMERA, options.entry, options.form)
    T = world.T @ invert(camera.T)
    return WrittenPose(f"{DAIR_WORLD} after the inverse of {DAIR_CAMERA}", T, from_map=False), statement


def _check_foreign(path: Path, file: Path) -> None:
    """Raise if a file is a result of this project, which needs no import."""
    if file.is_file() and b'"schema": "laci-calibration/' in read_content(file, CalibrationFileError)[:1000]:
        raise CalibrationFileError(
            f"{path} is a result already; needed is a file of another tool: check, compare and export take a result as "
            "it is"
        )


def _said(what: str, option: str, asked: str | None, stated: str | None, path: Path) -> str:
    if asked is None and stated is None:
        raise SettingError(f"{path} does not say {what}; needed is {option}")
    if asked is not None and stated is not None and asked != stated:
        raise SettingError(
            f"{path} says that {what} is {shortened(stated)}, the option {asked}; needed is {option} as the file has "
            "it, or without"
        )
    return asked or stated or ""


def _frame(path: Path, kind: str, stated: str | None, rectified: bool) -> str:
    """Return the description of the sensor's frame."""
    if rectified and (kind != "stereo" or stated not in (None, RECTIFIED_FRAME)):
        what = kind if stated is None else f"{kind}, its frame {quoted(stated)}"
        raise SettingError(
            f"{path}: the sensor is {what}; needed is a stereo camera of rectified images, or no --rectified"
        )
    return stated or (RECTIFIED_FRAME if rectified else _KIND_FRAMES[kind])


def _towards_map(path: Path, pose: WrittenPose, options: ImportOptions, kind: str) -> tuple[FloatArray, str]:
    """Return the transform from sensor to map, and a note on how its direction is known."""
    asked = options.direction
    stated = pose.from_map if asked is None else asked == "map-to-sensor"
    from_map = bool(stated)
    T, opposite = (invert(pose.T), pose.T) if from_map else (pose.T, invert(pose.T))
    # A file that states its direction may state its origin, too: without --origin any of its places is possible.
    origin = (*(options.origin or ()), 0.0, 0.0, 0.0)[:3] if options.origin or stated is None else None
    here, there = _is_possible(T, kind, origin), _is_possible(opposite, kind, origin)
    places = f"{_seen(T, kind)}, the other way {_seen(opposite, kind)}"
    if there and not here:
        axes = " or, of a camera, a pose with x right, y down, z forward" if _impossible(T, kind) else ""
        raise CalibrationFileError(
            f"{path}: {pose.name} read {_way(from_map)} puts the sensor {places}; needed is --direction "
            f"{_way(not from_map)}{axes}"
        )
    if stated is None and here and there:
        raise SettingError(
            f"{path} does not say which way {pose.name} leads: read {_way(from_map)} it puts the sensor {places}; "
            f"needed is --direction {_way(from_map)} or {_way(not from_map)}"
        )
    known = "as was asked" if asked else "assumed" if stated is None else "as the file says"
    return T, f"{_way(from_map)}, {known}"


def _way(from_map: bool) -> Direction:
    return "map-to-sensor" if from_map else "sensor-to-map"


def _is_possible(T_map_sensor: FloatArray, kind: str, origin: tuple[float, ...] | None) -> bool:
    """Return whether a sensor can stand there and so.

    ``origin`` is that of the map in UTM, with the ground's z; None if the map's place is known otherwise.
    """
    east, north, height = T_map_sensor[:3, 3] - (0.0, 0.0, 0.0 if origin is None else origin[2])
    in_utm = origin is None or _is_utm(east + origin[0], north + origin[1])
    return bool(in_utm and 0.0 < height <= HIGHEST_M and not _impossible(T_map_sensor, kind))


def _seen(T_map_sensor: FloatArray, kind: str) -> str:
    """Return the place and attitude of a sensor, in words."""
    x, y, z = T_map_sensor[:3, 3]
    upright = (T_map_sensor[:3, :3] @ np.array(_KIND_AXES[kind].up))[2] > 0.0
    return f"at x {x:.2f}, y {y:.2f}, z {z:.2f} m, {'upright' if upright else 'upside down'}"


def _in_utm(
    path: Path, T_map_sensor: FloatArray, origin: tuple[float, ...] | None, statement: Statement | None
) -> tuple[FloatArray, tuple[str, ...]]:
    """Add the map frame's origin, unless the numbers are UTM coordinates already; return the result with notes."""
    T = T_map_sensor.copy()
    east, north = T[:2, 3]
    if statement is not None:
        begins = (0.0, 0.0) if _is_of_grid(east, north, statement.world.origin_utm) else statement.world.origin_utm
        if origin is not None and (*origin, 0.0)[:3] != (*begins, 0.0):
            raise SettingError(
                f"{path} says that its map begins at UTM {begins[0]:.10g}, {begins[1]:.10g} on the ground, --origin "
                f"{', '.join(f'{value:.10g}' for value in origin)}; needed is --origin as the file has it, or without"
            )
        T[:2, 3] += begins
        return T, ()
    if origin is not None:
        T[:3, 3] += (*origin[:2], -(*origin, 0.0)[2])
        return T, (f"its map begins at UTM {origin[0]:.3f}, {origin[1]:.3f}, as was asked",)
    if _is_utm(east, north):
        return T, ()
    if _is_utm(east / 1000.0, north / 1000.0):
        raise CalibrationFileError(
            f"{path}: the translation is {east:.0f}, {north:.0f}; needed are UTM coordinates in metres: is it in "
            "millimetres?"
        )
    raise CalibrationFileError(
        f"{path}: the translation is {east:.6g}, {north:.6g}; needed are UTM coordinates in metres, --origin E,N where "
        "they count from, or --direction map-to-sensor"
    )


def _is_utm(east: float, north: float) -> bool:
    """Return whether coordinates are plausible in UTM: zones, even widened ones, lie within 450 km of 500 km east."""
    return 5e4 <= east <= 9.5e5 and 0.0 <= north <= 1e7


def _is_of_grid(east: float, north: float, origin: tuple[float, float]) -> bool:
    """Return whether coordinates are in the grid itself, not relative to its point ``origin``, which is near."""
    return math.hypot(east - origin[0], north - origin[1]) < math.hypot(east, north)


def _check_place(path: Path, T_utm_sensor: FloatArray, statement: Statement | None) -> None:
    east, north, height = T_utm_sensor[:3, 3]
    # A file of ours states the origin of its grid, and may extend into the neighbouring zone.
    if not (_is_utm(east, north) if statement is None else _is_of_grid(east, north, statement.world.origin_utm)):
        raise CalibrationFileError(
            f"{path}: the sensor would stand at UTM {east:.6g}, {north:.6g}; needed are metres in a UTM zone: look at "
            "--origin, and at the unit"
        )
    if not 0.0 < height <= HIGHEST_M:
        raise CalibrationFileError(
            f"{path}: the sensor would stand {height:.6g} m above the ground; needed are 0 to {HIGHEST_M:g}: where z "
            "is an altitude, --origin E,N,Z takes the ground's away; otherwise look at the unit and at --direction"
        )


def _check_mounting(path: Path, T_utm_sensor: FloatArray, kind: str, *, ours: bool) -> tuple[str, ...]:
    """Raise if a camera's pose is in another frame than its optical one; return a warning of an unusual attitude.

    The attitude in exports of this project is the one that it found, and looking into the sky is all that is not.
    """
    found = _impossible(T_utm_sensor, kind)
    if found and not (ours and viewing_angles(T_utm_sensor, OPENCV_AXES).down_deg >= -MOST_UP_DEG):
        raise CalibrationFileError(
            f"{path}: the camera would {found}; needed is the pose of its optical frame, x right, y down, z forward "
            "(of DAIR-V2X's cameras, the folder with both files): if it is that, look whether the rotation is "
            "transposed, and whether a quaternion is in the order x, y, z, w"
        )
    unusual = None if ours else _unusual(T_utm_sensor, kind)
    if unusual is None:
        return ()
    axes = "x right, y down, z forward" if kind == "stereo" else "x forward, y left, z up"
    note = (
        f"the sensor would {unusual}: if it is not so, its axes are others than {axes}, the rotation is transposed, or "
        "a quaternion is not in the order x, y, z, w"
    )
    return (note,)


def _impossible(T_map_sensor: FloatArray, kind: str) -> str | None:
    """Return what a sensor would do that none does."""
    if kind != "stereo":
        return None
    angles = viewing_angles(T_map_sensor, OPENCV_AXES)
    if -angles.down_deg > MOST_UP_DEG:
        return f"look {-angles.down_deg:.0f} deg up"
    if angles.down_deg <= STEEP_DEG and abs(angles.roll_deg) > 90.0:
        return f"be upside down, rolled {abs(angles.roll_deg):.0f} deg"
    return None


def _unusual(T_map_sensor: FloatArray, kind: str) -> str | None:
    """Return what a sensor would do that few do."""
    if kind != "stereo":
        up = float((T_map_sensor[:3, :3] @ np.array(_KIND_AXES[kind].up))[2])
        tilt_deg = math.degrees(math.acos(min(abs(up), 1.0)))
        return f"be tilted {tilt_deg:.0f} deg" if tilt_deg > MOST_ROLLED_DEG else None
    angles = viewing_angles(T_map_sensor, OPENCV_AXES)
    if -angles.down_deg > LEVEL_DEG:
        return f"look {-angles.down_deg:.0f} deg up"
    rolled = angles.down_deg <= STEEP_DEG and abs(angles.roll_deg) > MOST_ROLLED_DEG
    return f"be rolled {abs(angles.roll_deg):.0f} deg" if rolled else None


def _world(crs: str, T_utm_sensor: FloatArray, statement: Statement | None) -> World:
    if statement is not None and statement.world.crs == crs:
        return statement.world
    to_degrees = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    longitude, latitude = to_degrees.transform(float(T_utm_sensor[0, 3]), float(T_utm_sensor[1, 3]))
    if not (math.isfinite(longitude) and math.isfinite(latitude)):
        raise CalibrationFileError(f"{crs} knows no latitude at UTM {T_utm_sensor[0, 3]:.0f}, {T_utm_sensor[1, 3]:.0f}")
    return World.around(latitude, longitude, crs)


def _centre(
    world: World, T_utm_sensor: FloatArray, asked: tuple[float, float] | None, statement: Statement | None
) -> FloatArray:
    if asked is None and statement is not None:
        return statement.centre_world
    utm = T_utm_sensor[:2, 3] if asked is None else np.array(asked)
    away_m = float(np.linalg.norm(utm - T_utm_sensor[:2, 3]))
    if away_m > FARTHEST_CENTRE_M:
        raise SettingError(
            f"--centre is {utm[0]:.10g},{utm[1]:.10g}, {away_m:.0f} m from the sensor; needed are UTM coordinates "
            f"within {FARTHEST_CENTRE_M:.0f} m of it"
        )
    return np.append(world.from_utm(utm[None])[0], 0.0)


def _in_world(
    world: World, T_utm_sensor: FloatArray, grid_scale: float | None, centre_world: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return ``T_world_sensor`` and the centre; a transform that includes the grid scale is exact everywhere."""
    T_map_sensor = T_utm_sensor.copy()
    T_map_sensor[:2, 3] -= world.origin_utm
    if grid_scale is None:
        return rigid_in_grid(world, T_map_sensor, centre_world), centre_world
    T_map_sensor[:2, 3] /= grid_scale
    return T_map_sensor, centre_world


def imported_document(imported: Imported, inputs: dict[str, str], options: dict[str, object]) -> Document:
    """Return an imported transform as a result document, with null for unknown quantities.

    Raises
    ------
    CalibrationFileError
        If the document does not conform to the schema.
    """
    siting = imported.siting
    angles = viewing_angles(siting.T_world_sensor, _KIND_AXES[siting.kind])
    document: Document = {
        **beginning(siting, "imported"),
        "T_enu_sensor": None,
        "slope": None,
        "height_m": float(siting.T_world_sensor[2, 3]),
        "euler_deg": {"yaw": angles.yaw_deg, "down": angles.down_deg, "roll": angles.roll_deg},
        **dict.fromkeys(("time_offset_s", "time_sigma_s", "station_id", "vehicle", "covariance", "quality", "paper")),
        "covariance_centre_world": siting.centre_world.tolist(),
        "background_boxes": [],
        "inputs": inputs,
        "notes": list(imported.notes),
        "config": {"import": options, **({"stereo": {"rectified": True}} if siting.frame == RECTIFIED_FRAME else {})},
    }
    validate(document)
    return document
