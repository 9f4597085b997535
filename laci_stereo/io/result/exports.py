"""A calibration in the formats of other tools, each with a description of frames, units and directions."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
from scipy.spatial.transform import Rotation

from laci_stereo.core.errors import SettingError
from laci_stereo.core.frames import OPENCV_AXES, FloatArray, invert, rigid, rotation_z
from laci_stereo.core.result import viewing_angles
from laci_stereo.io.result.siting import STATEMENT, Siting, comments, statement, words

_STREAMS = {"stereo": "camera", "lidar": "lidar"}


@dataclass(frozen=True)
class ExportedFile:
    """A file in the format of another tool."""

    name: str
    text: str


@dataclass(frozen=True)
class ExportFormat:
    """A format of another tool; ``meaning`` is its content and the tools that read it, in one line."""

    name: str
    meaning: str
    write: Callable[[Siting], tuple[ExportedFile, ...]]


def export_as(siting: Siting, name: str) -> tuple[ExportedFile, ...]:
    """Return a calibration as files of the named format.

    Raises
    ------
    SettingError
        If no format has that name.
    """
    for each in FORMATS:
        if each.name == name:
            return each.write(siting)
    raise SettingError(f"--to is {name!r}; needed is one of {', '.join(each.name for each in FORMATS)}")


def frame_id(siting: Siting) -> str:
    """Return a sensor's name as a valid ROS frame name: letters, digits and underscores."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", siting.name).strip("_") or "sensor"
    plain = plain if plain[0].isalpha() else f"sensor_{plain}"
    return f"{plain}_optical_frame" if siting.kind == "stereo" else plain


def _row(numbers: FloatArray) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _matrix(siting: Siting) -> tuple[ExportedFile, ...]:
    rows = "".join(f"{_row(row)}\n" for row in siting.T_utm_sensor)
    return (ExportedFile("T_utm_sensor.txt", comments(siting, absolute=True) + rows),)


def _opencv(siting: Siting) -> tuple[ExportedFile, ...]:
    T_sensor_map = invert(siting.T_map_sensor)
    rvec = Rotation.from_matrix(T_sensor_map[:3, :3]).as_rotvec()
    text = (
        f"%YAML:1.0\n---\n{comments(siting)}"
        f"crs: {json.dumps(siting.world.crs)}\n"
        f"origin_utm: {_opencv_matrix(np.array([siting.world.origin_utm]).T)}"
        f"T_map_sensor: {_opencv_matrix(siting.T_map_sensor)}"
        "# the other way round, map to sensor, as cv::projectPoints takes them for points of the map\n"
        f"rvec: {_opencv_matrix(rvec[:, None])}"
        f"tvec: {_opencv_matrix(T_sensor_map[:3, 3:])}"
    )
    return (ExportedFile("extrinsics.yaml", text),)


def _opencv_matrix(matrix: FloatArray) -> str:
    rows, columns = matrix.shape
    numbers = ",\n      ".join(", ".join(repr(float(number)) for number in row) for row in matrix)
    return f"!!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {numbers} ]\n"


def _ros2(siting: Siting) -> tuple[ExportedFile, ...]:
    T, name = siting.T_map_sensor, frame_id(siting)
    x, y, z = map(float, T[:3, 3])
    qx, qy, qz, qw = map(float, Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True))
    arguments = (
        f"--x {x!r} --y {y!r} --z {z!r} --qx {qx!r} --qy {qy!r} --qz {qz!r} --qw {qw!r} "
        f"--frame-id map --child-frame-id {name}"
    )
    text = (
        f"# ros2 launch ./{name}.launch.yaml\n{comments(siting)}"
        "launch:\n- node:\n    pkg: tf2_ros\n    exec: static_transform_publisher\n"
        f'    name: {name}_from_map\n    args: "{arguments}"\n'
    )
    return (ExportedFile(f"{name}.launch.yaml", text),)


def _autoware(siting: Siting) -> tuple[ExportedFile, ...]:
    values = zip(("x", "y", "z", "roll", "pitch", "yaw"), _xyzrpy(siting.T_map_sensor), strict=True)
    entries = "".join(f"    {key}: {value!r}\n" for key, value in values)
    rule = "# roll, pitch, yaw: radians about the map's fixed x, then y, then z axis\n"
    return (
        ExportedFile("sensor_kit_calibration.yaml", f"{comments(siting)}{rule}map:\n  {frame_id(siting)}:\n{entries}"),
    )


def _xyzrpy(T: FloatArray) -> list[float]:
    """Return the translation, and angles about the fixed x, y and z axes; one solution of many if pitch is 90 deg."""
    level = float(np.hypot(T[0, 0], T[1, 0]))
    if level > 1e-9:
        roll, yaw = np.arctan2(T[2, 1], T[2, 2]), np.arctan2(T[1, 0], T[0, 0])
    else:  # roll and yaw rotate about the same axis
        roll, yaw = 0.0, np.arctan2(-T[0, 1], T[1, 1])
    return [*map(float, T[:3, 3]), float(roll), float(np.arctan2(-T[2, 0], level)), float(yaw)]


def _openlabel(siting: Siting) -> tuple[ExportedFile, ...]:
    name = frame_id(siting)
    sentences = words(siting, absolute=False)
    document = {
        "openlabel": {
            "metadata": {
                "schema_version": "1.0.0",
                "annotator": f"laci-stereo {version('laci-stereo')}",
                "comment": "; ".join(sentences),
                STATEMENT: statement(siting),
            },
            "coordinate_systems": {
                "map": {"type": "scene_cs", "parent": "", "children": [name], "description": sentences[1]},
                name: {
                    "type": "sensor_cs",
                    "parent": "map",
                    "children": [],
                    "pose_wrt_parent": {"matrix4x4": siting.T_map_sensor.ravel().tolist()},
                    "description": "; ".join(sentences[:1] + sentences[2:]),
                },
            },
            "streams": {name: {"type": _STREAMS.get(siting.kind, "other"), "description": sentences[0]}},
        }
    }
    return (ExportedFile("openlabel.json", _json(document)),)


def _kitti(siting: Siting) -> tuple[ExportedFile, ...]:
    # KITTI's files have no comments, but text entries among those of numbers, which readers skip.
    T = siting.T_map_sensor
    lines = (
        *words(siting, absolute=False),
        f"{STATEMENT}: {json.dumps(statement(siting))}",
        f"R: {_row(T[:3, :3].ravel())}",
        f"T: {_row(T[:3, 3])}",
        f"Tr_sensor_to_map: {_row(T[:3].ravel())}",
    )
    return (ExportedFile("calib.txt", "".join(f"{line}\n" for line in lines)),)


def _dair(siting: Siting) -> tuple[ExportedFile, ...]:
    if siting.kind != "stereo":
        return (_dair_world(siting, siting.T_utm_sensor, "the sensor's own frame"),)
    # Boxes rotate about the z axis of a virtual LiDAR only, so it is level: at the camera, with the camera's yaw.
    yaw_rad = np.radians(viewing_angles(siting.T_world_sensor, OPENCV_AXES).yaw_deg)
    T_utm_virtual = rigid(rotation_z(float(yaw_rad)), siting.T_utm_sensor[:3, 3])
    T_sensor_virtual = rigid(siting.T_world_sensor[:3, :3].T @ T_utm_virtual[:3, :3], np.zeros(3))
    camera = {
        **_dair_transform(T_sensor_virtual),
        "direction": "virtual LiDAR to camera, metres; camera_intrinsic is not known here",
    }
    frame = "stands in the camera, level: x = where the camera looks, z = up"
    return (
        _dair_world(siting, T_utm_virtual, frame),
        ExportedFile("virtuallidar_to_camera.json", _json(camera)),
    )


def _dair_world(siting: Siting, T_utm_virtual: FloatArray, frame: str) -> ExportedFile:
    document = {
        **_dair_transform(T_utm_virtual),
        "relative_error": {"delta_x": 0.0, "delta_y": 0.0},
        "direction": "virtual LiDAR to world, p_world = rotation p_virtuallidar + translation",
        "virtuallidar": frame,
        "world": words(siting, absolute=True)[1],
        "scale": words(siting, absolute=True)[3],
        STATEMENT: statement(siting),
    }
    return ExportedFile("virtuallidar_to_world.json", _json(document))


def _dair_transform(T: FloatArray) -> dict[str, object]:
    return {"rotation": T[:3, :3].tolist(), "translation": T[:3, 3:].tolist()}


def _proj(siting: Siting) -> tuple[ExportedFile, ...]:
    scale = np.array([siting.world.grid_scale, siting.world.grid_scale, 1.0])
    linear = siting.T_world_sensor[:3, :3] * scale[:, None]
    offsets = siting.T_world_sensor[:3, 3] * scale + np.append(siting.world.origin_utm, 0.0)
    entries = [f"+{axis}off={float(value)!r}" for axis, value in zip("xyz", offsets, strict=True)]
    entries += [f"+s{i + 1}{j + 1}={float(linear[i, j])!r}" for i in range(3) for j in range(3)]
    # A pipeline has no comments, only a title without spaces. Being affine, it includes the grid scale, and is exact.
    title = f"sensor_metres_to_{siting.world.crs}_east,north_and_metres_over_the_ground"
    return (
        ExportedFile("sensor_to_utm.proj", f"+proj=pipeline +title={title} +step +proj=affine {' '.join(entries)}\n"),
    )


def _json(document: object) -> str:
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


FORMATS = (
    ExportFormat("matrix", "T_utm_sensor, 4 x 4 numbers, sensor to UTM: numpy.loadtxt and most other tools", _matrix),
    ExportFormat(
        "opencv", "FileStorage YAML: T_map_sensor, and rvec and tvec from map to sensor for cv2.projectPoints", _opencv
    ),
    ExportFormat(
        "ros2", "launch file that starts tf2_ros static_transform_publisher: the sensor's frame in map", _ros2
    ),
    ExportFormat(
        "autoware", "sensor kit calibration YAML: x, y, z, roll, pitch, yaw of the sensor in the map", _autoware
    ),
    ExportFormat("openlabel", "ASAM OpenLABEL 1.0 JSON: coordinate systems map and sensor, and the stream", _openlabel),
    ExportFormat("kitti", "calib.txt with R, T and Tr_sensor_to_map, sensor to map", _kitti),
    ExportFormat(
        "dair", "DAIR-V2X virtuallidar_to_world.json; of a camera also virtuallidar_to_camera.json (a folder)", _dair
    ),
    ExportFormat("proj", "PROJ pipeline, sensor to UTM, grid scale included: pyproj, cct", _proj),
)
