"""Transforms of other tools come back as they were meant, and wrong ones are named."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from laci_stereo.core.errors import CalibrationFileError, InputError, SettingError
from laci_stereo.core.frames import FloatArray, invert, transform
from laci_stereo.io.result.calibration_file import to_text
from laci_stereo.io.result.exports import FORMATS, export_as
from laci_stereo.io.result.imported import Imported, ImportOptions, import_pose, imported_document
from laci_stereo.io.result.siting import Siting
from laci_stereo.io.result.stored_calibration import read_calibration
from laci_stereo.io.rig.stereo_rig import RAW_FRAME, RECTIFIED_FRAME
from tests.io.sitings import CONTINUED, FIJI, SITINGS, ULM, siting, sitings, ten_points
from tests.io.support import SHARED, fuzz, mutations, needs_shared, noise, read_or_refused

STEREO = siting("stereo")
LIDAR = siting("lidar", down_deg=3.0)
ORIGIN = (569000.0, 5363000.0)
TWO_ULP_OF_A_NORTHING = 2 * np.spacing(1e7)
LOCAL = tuple(each.name for each in FORMATS if each.name not in ("matrix", "dair", "proj"))


def exported(folder: Path, sited: Siting, form: str) -> Path:
    written = export_as(sited, form)
    for file in written:
        (folder / file.name).write_text(file.text)
    return folder if len(written) > 1 else folder / written[0].name


def taken(path: Path, text: str | None = None, **options: object) -> Imported:
    """Import a file, with this text if it is to be written first."""
    if text is not None:
        path.write_text(text)
    return import_pose(path, ImportOptions(**{"kind": "lidar", "crs": "EPSG:32632", **options}))  # type: ignore[arg-type]


def assert_stands(found: Siting, T_utm_sensor: FloatArray) -> None:
    np.testing.assert_allclose(found.T_utm_sensor, T_utm_sensor, rtol=0, atol=1e-8)


@pytest.mark.parametrize("form", [each.name for each in FORMATS if each.name != "proj"])
@pytest.mark.parametrize(
    "sited", [*SITINGS[:3], siting("lidar", CONTINUED)], ids=["stereo", "lidar", "detections", "continued"]
)
def test_every_export_of_ours_comes_back(tmp_path: Path, sited: Siting, form: str) -> None:
    path = exported(tmp_path, sited, form)
    back = import_pose(path, ImportOptions()).siting
    assert (back.kind, back.frame, back.world) == (sited.kind, sited.frame, sited.world)
    assert back.name == sited.name
    # Coordinates of UTM have no more digits than that.
    apart = 1e-9 if form in LOCAL else TWO_ULP_OF_A_NORTHING
    np.testing.assert_allclose(back.T_world_sensor, sited.T_world_sensor, rtol=0, atol=apart)
    np.testing.assert_allclose(back.T_utm_sensor, sited.T_utm_sensor, rtol=0, atol=TWO_ULP_OF_A_NORTHING)
    np.testing.assert_array_equal(back.centre_world, sited.centre_world)


@fuzz
@given(sitings(), st.sampled_from(LOCAL))
def test_any_place_comes_back(tmp_path: Path, sited: Siting, form: str) -> None:
    back = import_pose(exported(tmp_path, sited, form), ImportOptions()).siting
    np.testing.assert_allclose(back.T_world_sensor, sited.T_world_sensor, rtol=0, atol=1e-9)


def test_looking_straight_down_costs_angles_no_more_than_their_digits(tmp_path: Path) -> None:
    back = import_pose(exported(tmp_path, SITINGS[3], "autoware"), ImportOptions()).siting
    np.testing.assert_allclose(back.T_world_sensor, SITINGS[3].T_world_sensor, rtol=0, atol=1e-8)


@pytest.mark.parametrize("sited", SITINGS[:3], ids=["stereo", "lidar", "detections"])
def test_pipeline_comes_back_with_its_scale(tmp_path: Path, sited: Siting) -> None:
    path = exported(tmp_path, sited, "proj")
    kind = "lidar" if sited.kind == "detections" else sited.kind
    back = import_pose(path, ImportOptions(kind=kind, crs=sited.world.crs)).siting
    np.testing.assert_allclose(in_utm(back), in_utm(sited), rtol=0, atol=2 * TWO_ULP_OF_A_NORTHING)


def in_utm(sited: Siting) -> FloatArray:
    points_world = transform(sited.T_world_sensor, ten_points())
    return np.column_stack([sited.world.to_utm(points_world[:, :2]), points_world[:, 2]])


def test_the_document_is_a_result_that_others_read(tmp_path: Path) -> None:
    imported = import_pose(exported(tmp_path, STEREO, "opencv"), ImportOptions())
    result = tmp_path / "calibration.json"
    result.write_text(to_text(imported_document(imported, {"x": "y"}, {})))
    stored = read_calibration(result)
    assert not stored.claims
    assert np.isnan(stored.covariance).all()
    np.testing.assert_allclose(stored.T_utm_sensor, STEREO.T_utm_sensor, rtol=0, atol=TWO_ULP_OF_A_NORTHING)
    assert stored.angles_deg == pytest.approx((0.8, 15.0, 114.7))


def test_only_an_imported_result_may_claim_nothing(tmp_path: Path) -> None:
    imported = import_pose(exported(tmp_path, STEREO, "opencv"), ImportOptions())
    document = imported_document(imported, {}, {})
    document["method"] = "joint"
    result = tmp_path / "calibration.json"
    result.write_text(json.dumps(document))
    with pytest.raises(CalibrationFileError, match="None is not of type"):
        read_calibration(result)


# What other tools write: the same LiDAR, whose map frame begins at ORIGIN.
T_MAP = LIDAR.T_map_sensor.copy()
T_MAP[:2, 3] += np.array(LIDAR.world.origin_utm) - ORIGIN
R, T = T_MAP[:3, :3], T_MAP[:3, 3]
QUATERNION = Rotation.from_matrix(R).as_quat()
ROLL, PITCH, YAW = Rotation.from_matrix(R).as_euler("xyz")
ROLL_DEG, PITCH_DEG, YAW_DEG = Rotation.from_matrix(R).as_euler("xyz", degrees=True).tolist()
WXYZ = QUATERNION[[3, 0, 1, 2]].tolist()
ANGLES_DEG = {"roll_deg": ROLL_DEG, "pitch_deg": PITCH_DEG, "yaw_deg": YAW_DEG}
XYZ = dict(zip("xyz", T.tolist(), strict=True))


# The same, 6.5 m high again, in a map where its inverse is a possible pose as well.
T_NEAR = T_MAP.copy()
T_NEAR[:2, 3] = 40.0, -200.0
NEAR_ORIGIN = tuple(T_MAP[:2, 3] + ORIGIN - T_NEAR[:2, 3])


def rows(matrix: FloatArray, separator: str = " ") -> str:
    return "\n".join(separator.join(repr(float(value)) for value in row) for row in matrix)


def opencv_yaml(**matrices: FloatArray) -> str:
    storage = cv2.FileStorage(".yaml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, matrix in matrices.items():
        storage.write(name, matrix)
    return str(storage.releaseAndGetString())


WRITTEN = {
    "plain": rows(T_MAP),
    "three rows, commas": rows(T_MAP[:3], ","),
    "comments": f"# made by hand\n{rows(T_MAP)}\n// end\n",
    "json matrix": json.dumps({"transform": T_MAP.tolist()}),
    "json list": json.dumps({"sensor": {"extrinsic": T_MAP.ravel().tolist()}}),
    "json rotation": json.dumps({"R": R.tolist(), "t": T.tolist()}),
    "json column": json.dumps({"rotation": R.tolist(), "translation": T[:, None].tolist()}),
    "quaternion names": yaml.safe_dump(
        {"transform": {"translation": XYZ, "rotation": dict(zip("xyzw", QUATERNION.tolist(), strict=True))}}
    ),
    "quaternion list": yaml.safe_dump({"position": T.tolist(), "orientation": QUATERNION.tolist()}),
    "flat quaternion": yaml.safe_dump({**XYZ, **dict(zip(("qx", "qy", "qz", "qw"), QUATERNION.tolist(), strict=True))}),
    "angles": yaml.safe_dump(
        {"map": {"lidar": {**XYZ, "roll": float(ROLL), "pitch": float(PITCH), "yaw": float(YAW)}}}
    ),
    "rpy": yaml.safe_dump({"xyz": T.tolist(), "rpy": [float(ROLL), float(PITCH), float(YAW)]}),
    "rpy, degrees": yaml.safe_dump({"translation": T.tolist(), "rpy_deg": [ROLL_DEG, PITCH_DEG, YAW_DEG]}),
    "ypr": yaml.safe_dump({"translation": T.tolist(), "ypr": [float(YAW), float(PITCH), float(ROLL)]}),
    "ypr, degrees": yaml.safe_dump({"translation_m": T.tolist(), "yaw_pitch_roll_deg": [YAW_DEG, PITCH_DEG, ROLL_DEG]}),
    "angles, degrees": yaml.safe_dump({**XYZ, **ANGLES_DEG}),
    "angles, degrees, metres": json.dumps({**{f"{axis}_m": value for axis, value in XYZ.items()}, **ANGLES_DEG}),
    "angles inside": json.dumps({"translation": XYZ, "rotation": ANGLES_DEG}),
    "angles inside, unit outside": json.dumps(
        {"translation": XYZ, "euler_deg": {"yaw": YAW_DEG, "pitch": PITCH_DEG, "roll": ROLL_DEG}}
    ),
    "quaternion, w first": json.dumps({"translation": T.tolist(), "quaternion_wxyz": WXYZ}),
    "quaternion, w last": json.dumps({"translation": T.tolist(), "q_xyzw": QUATERNION.tolist()}),
    "quaternion, w first by name": yaml.safe_dump(
        {"translation": XYZ, "rotation_wxyz": dict(zip("wxyz", WXYZ, strict=True))}
    ),
    "quaternion, w first, as a matrix": opencv_yaml(t=T[:, None], quaternion_wxyz=np.array(WXYZ)[:, None]),
    "quaternion, w first, as text": f"translation: {rows(T[None])}\nquaternion_wxyz: {rows(np.array([WXYZ]))}\n",
    "euler beside a quaternion": json.dumps(
        {"translation": T.tolist(), "euler": [0.1, 0.2, 0.3], "quaternion": QUATERNION.tolist()}
    ),
    "opencv": opencv_yaml(T_map_lidar=T_MAP),
    "opencv inverse": opencv_yaml(T_lidar_map=invert(T_MAP)),
    "solvePnP": opencv_yaml(
        rvec=Rotation.from_matrix(R.T).as_rotvec()[:, None], tvec=-(R.T @ T)[:, None], rms=np.array([[0.4]])
    ),
    "kitti": f"calib_time: 09-Jan-2012 13:57:47\nR: {rows(R.reshape(1, 9))}\nT: {rows(T[None])}\n",
    "command line": "ros2 run tf2_ros static_transform_publisher "
    + " ".join(f"--{key} {value!r}" for key, value in XYZ.items())
    + f" --yaw {YAW} --pitch {PITCH} --roll {ROLL} --frame-id map --child-frame-id lidar",
    "python launch": "Node(package='tf2_ros', executable='static_transform_publisher', arguments=["
    + ", ".join(f"'--{key}', '{value!r}'" for key, value in XYZ.items())
    + ", "
    + ", ".join(f"'--q{axis}', '{float(value)!r}'" for axis, value in zip("xyzw", QUATERNION, strict=True))
    + ", '--frame-id', 'map', '--child-frame-id', 'lidar'])",
}


@pytest.mark.parametrize("text", WRITTEN.values(), ids=WRITTEN.keys())
def test_what_other_tools_write(tmp_path: Path, text: str) -> None:
    found = taken(tmp_path / "mast.txt", text, origin=ORIGIN, centre=tuple(centre_utm())).siting
    assert_stands(found, LIDAR.T_utm_sensor)
    np.testing.assert_allclose(in_utm(found), in_utm(LIDAR), rtol=0, atol=1e-5)
    assert (found.name, found.kind) == ("mast", "lidar")


@pytest.mark.parametrize("name", ["euler", "euler_deg", "euler_angles", "euler_xyz", "rotation"])
def test_three_angles_in_an_order_that_nobody_knows_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(CalibrationFileError, match=rf"{name} is three numbers, whose order .* rpy or ypr .*_wxyz"):
        taken(tmp_path / "mast.yaml", yaml.safe_dump({"translation": T.tolist(), name: [0.1, 0.2, 0.3]}), origin=ORIGIN)


def test_a_quaternions_order_is_noted_where_no_name_tells_it(tmp_path: Path) -> None:
    path = tmp_path / "mast.yaml"
    for name, noted in (("quaternion", True), ("quaternion_xyzw", False)):
        path.write_text(yaml.safe_dump({"translation": T.tolist(), name: QUATERNION.tolist()}))
        assert any("taken as x, y, z, w" in note for note in taken(path, origin=ORIGIN).notes) == noted


def centre_utm() -> FloatArray:
    return LIDAR.world.to_utm(LIDAR.centre_world[None, :2])[0]


def test_utm_needs_no_origin_and_an_inverse_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "T.txt"
    assert_stands(taken(path, rows(LIDAR.T_utm_sensor)).siting, LIDAR.T_utm_sensor)
    found = taken(path, rows(invert(LIDAR.T_utm_sensor)), direction="map-to-sensor").siting
    np.testing.assert_allclose(found.T_utm_sensor, LIDAR.T_utm_sensor, rtol=0, atol=1e-7)


def test_an_altitude_is_counted_from_the_ground(tmp_path: Path) -> None:
    path = tmp_path / "T.txt"
    T_utm = LIDAR.T_utm_sensor.copy()
    T_utm[2, 3] += 478.0
    with pytest.raises(CalibrationFileError, match=r"484\.5 m above the ground; needed .* --origin E,N,Z"):
        taken(path, rows(T_utm))
    found = taken(path, origin=(0.0, 0.0, 478.0)).siting
    assert found.T_world_sensor[2, 3] == pytest.approx(6.5)


def test_of_several_transforms_one_is_named(tmp_path: Path) -> None:
    path = tmp_path / "kit.yaml"
    kit = {name: {**XYZ, "roll": 0.0, "pitch": 0.0, "yaw": yaw} for name, yaw in (("left", 0.3), ("right", -0.3))}
    with pytest.raises(
        CalibrationFileError, match=r"it holds 2 transforms, map/left, map/right; needed is --entry NAME"
    ):
        taken(path, yaml.safe_dump({"map": kit}), origin=ORIGIN)
    with pytest.raises(
        CalibrationFileError, match="holds no 'middle'; needed is --entry with one of map/left, map/right"
    ):
        taken(path, origin=ORIGIN, entry="middle")
    found = taken(path, origin=ORIGIN, entry="map/right").siting.T_world_sensor
    assert np.arctan2(found[1, 0], found[0, 0]) == pytest.approx(-0.3)


def quaternion_of(T_a_b: FloatArray) -> list[float]:
    return [float(value) for value in Rotation.from_matrix(T_a_b[:3, :3]).as_quat()]


def numbers(*parts: float) -> str:
    return " ".join(repr(float(value)) for value in parts)


def by_position(T_a_b: FloatArray, parent: str, child: str, angles: bool) -> str:
    """Return the arguments of static_transform_publisher in ROS 1."""
    turn = Rotation.from_matrix(T_a_b[:3, :3]).as_euler("ZYX") if angles else quaternion_of(T_a_b)
    return f"{numbers(*T_a_b[:3, 3], *turn)} {parent} {child}"


def by_name(T_a_b: FloatArray, parent: str, child: str) -> str:
    values = zip(("x", "y", "z", "qx", "qy", "qz", "qw"), [*T_a_b[:3, 3].tolist(), *quaternion_of(T_a_b)], strict=True)
    options = " ".join(f"--{key} {value!r}" for key, value in values)
    return f"ros2 run tf2_ros static_transform_publisher {options} --frame-id {parent} --child-frame-id {child}"


def stamped(T_a_b: FloatArray, parent: str, child: str) -> str:
    """Return what Apollo's files hold, and ROS prints of a TransformStamped."""
    transform = {
        "translation": dict(zip("xyz", T_a_b[:3, 3].tolist(), strict=True)),
        "rotation": dict(zip("xyzw", quaternion_of(T_a_b), strict=True)),
    }
    header = {"seq": 0, "stamp": {"secs": 0, "nsecs": 0}, "frame_id": parent}
    return yaml.safe_dump({"header": header, "child_frame_id": child, "transform": transform})


STATED: dict[str, Callable[[FloatArray, str, str], str]] = {
    "named arguments": by_name,
    "angles by position": lambda T, a, b: f"rosrun tf static_transform_publisher {by_position(T, a, b, True)} 100\n",
    "angles without period": lambda T, a, b: (
        f'<launch><node pkg="tf2_ros" type="static_transform_publisher" name="x" args="{by_position(T, a, b, True)}"/>'
        "</launch>"
    ),
    "quaternion by position": lambda T, a, b: (
        f"rosrun tf2_ros static_transform_publisher {by_position(T, a, b, False)}\n"
    ),
    "quaternion with period": lambda T, a, b: (
        "Node(package='tf', executable='static_transform_publisher', arguments=["
        + ", ".join(f"'{word}'" for word in by_position(T, a, b, False).split())
        + ", '100'])"
    ),
    "stamped": stamped,
    "several stamped": lambda T, a, b: json.dumps({"transforms": [yaml.safe_load(stamped(T, a, b))]}),
    "matrix in a message": lambda T, a, b: json.dumps({"frame_id": a, "child_frame_id": b, "matrix": T.tolist()}),
    "kitti": lambda T, a, b: f"Tr_{b}_to_{a}: {numbers(*T[:3].ravel())}\n",
    "T_a_b": lambda T, a, b: json.dumps({f"T_{a}_{b}": T.tolist()}),
    "camel case": lambda T, a, b: json.dumps({f"{b}To{a.title()}": T.tolist()}),
    "named parts": lambda T, a, b: json.dumps(
        {f"{b}2{a}": {"rotation": T[:3, :3].tolist(), "translation": T[:3, 3].tolist()}}
    ),
}


@pytest.mark.parametrize("world", ["map", "world", "utm", "odom"])
@pytest.mark.parametrize("form", STATED)
def test_the_direction_that_a_file_states_is_its_own(tmp_path: Path, form: str, world: str) -> None:
    """In ROS a transform takes points of the child's frame to the parent's."""
    for T, frames, way in (
        (T_NEAR, (world, "lidar"), "sensor-to-map"),
        (invert(T_NEAR), ("lidar", world), "map-to-sensor"),
    ):
        imported = taken(tmp_path / "mast.txt", STATED[form](T, *frames), origin=NEAR_ORIGIN)
        assert_stands(imported.siting, LIDAR.T_utm_sensor)
        assert f", {way}, as the file says" in imported.notes[0]


@pytest.mark.parametrize("frame", ["/map", "site_4/map", "map_frame", "utm_32n", "World"])
def test_frames_of_maps_go_by_several_names(tmp_path: Path, frame: str) -> None:
    found = taken(tmp_path / "mast.txt", by_name(invert(T_NEAR), "mapping_lidar", frame), origin=NEAR_ORIGIN).siting
    assert_stands(found, LIDAR.T_utm_sensor)


def test_a_pose_in_the_frame_of_a_map_is_the_sensors(tmp_path: Path) -> None:
    pose = {"position": T_NEAR[:3, 3].tolist(), "orientation": quaternion_of(T_NEAR)}
    found = taken(
        tmp_path / "mast.txt", json.dumps({"header": {"frame_id": "map"}, "pose": pose}), origin=NEAR_ORIGIN
    ).siting
    assert_stands(found, LIDAR.T_utm_sensor)


def test_a_frame_below_the_maps_is_the_sensors(tmp_path: Path) -> None:
    """As in Autoware; a map below something else is not in its files, and tells nothing."""
    path = tmp_path / "kit.yaml"
    angles = dict(zip(("roll", "pitch", "yaw"), [float(ROLL), float(PITCH), float(YAW)], strict=True))
    pose = {**dict(zip("xyz", T_NEAR[:3, 3].tolist(), strict=True)), **angles}
    found = taken(path, yaml.safe_dump({"map": {"lidar": pose}}), origin=NEAR_ORIGIN).siting
    assert_stands(found, LIDAR.T_utm_sensor)
    with pytest.raises(SettingError, match="needed is --direction sensor-to-map or map-to-sensor"):
        taken(path, yaml.safe_dump({"lidar": {"map": pose}}), origin=NEAR_ORIGIN)


def test_the_name_of_a_file_states_what_is_not_in_it(tmp_path: Path) -> None:
    imported = taken(tmp_path / "map_to_lidar.txt", rows(invert(T_NEAR)), origin=NEAR_ORIGIN)
    assert_stands(imported.siting, LIDAR.T_utm_sensor)
    assert "the direction is told by the file's name alone" in imported.notes


@pytest.mark.parametrize(
    "text",
    [
        rows(T_NEAR),
        rows(invert(T_NEAR)),
        by_name(T_NEAR, "base_link", "lidar"),
        by_name(T_NEAR, "map", "odom"),
        json.dumps({"map_top_lidar": T_NEAR.tolist()}),
        json.dumps({"velo_to_cam": T_NEAR.tolist()}),
    ],
    ids=range(6),
)
def test_a_direction_that_is_not_stated_is_asked_for_where_both_are_possible(tmp_path: Path, text: str) -> None:
    path = tmp_path / "mast.txt"
    with pytest.raises(SettingError, match=r"does not say which way .* leads") as no:
        taken(path, text, origin=NEAR_ORIGIN)
    (line,) = str(no.value).splitlines()
    assert "at x 40.00, y -200.00, z 6.50 m, upright" in line
    assert line.endswith("needed is --direction sensor-to-map or map-to-sensor")
    taken(path, origin=NEAR_ORIGIN, direction="sensor-to-map")


def test_of_a_lidar_that_hangs_upside_down_the_direction_is_asked_for(tmp_path: Path) -> None:
    """Its inverse is as far above the ground."""
    T = T_NEAR.copy()
    T[:3, :3] = Rotation.from_euler("ZX", [114.7, 180.0], degrees=True).as_matrix()
    path = tmp_path / "mast.txt"
    with pytest.raises(SettingError, match=r"upside down, .* needed is --direction sensor-to-map or"):
        taken(path, rows(T), origin=NEAR_ORIGIN)
    imported = taken(path, origin=NEAR_ORIGIN, direction="sensor-to-map")
    np.testing.assert_allclose(imported.siting.T_utm_sensor[:3, :3], T[:3, :3], rtol=0, atol=1e-12)
    assert not any("tilted" in note for note in imported.notes)


@fuzz
@given(sitings(), st.floats(-500.0, 500.0), st.floats(-500.0, 500.0))
def test_no_transform_is_read_the_wrong_way_round_in_silence(
    tmp_path: Path, sited: Siting, east: float, north: float
) -> None:
    T = sited.T_utm_sensor
    origin = (T[0, 3] - east, T[1, 3] - north)
    T[:2, 3] = east, north
    kind = "stereo" if sited.kind == "stereo" else "lidar"
    with pytest.raises(InputError, match="needed is --direction"):
        taken(tmp_path / "T.txt", rows(invert(T)), kind=kind, crs=sited.world.crs, origin=origin)


def camera(yaw_deg: float, down_deg: float, roll_deg: float) -> FloatArray:
    """Return ``T_utm_sensor`` of a camera, rolled clockwise as seen from behind it."""
    T = STEREO.T_utm_sensor
    level = Rotation.from_euler("ZYX", [yaw_deg, down_deg, roll_deg], degrees=True).as_matrix()
    T[:3, :3] = level @ np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return T


def test_cameras_in_other_axes_are_refused(tmp_path: Path) -> None:
    T = camera(30.0, 15.0, 1.0)
    open_gl, transposed = T.copy(), camera(100.0, 15.0, 1.0)
    open_gl[:3, :3] = T[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    transposed[:3, :3] = transposed[:3, :3].T
    for wrong in (open_gl, transposed, camera(30.0, 15.0, 180.0), camera(30.0, 15.0, -95.0)):
        with pytest.raises(CalibrationFileError, match=r"upside down, rolled .* needed is .* x right, y down") as no:
            taken(tmp_path / "T.txt", rows(wrong), kind="stereo")
        (line,) = str(no.value).splitlines()
        assert "the rotation is transposed" in line
        assert "x, y, z, w" in line


def test_a_cameras_quaternion_in_the_wrong_order_is_refused(tmp_path: Path) -> None:
    T = camera(114.7, 15.0, 0.8)
    x, y, z, w = quaternion_of(T)
    path = tmp_path / "T.yaml"
    right = yaml.safe_dump({"translation": T[:3, 3].tolist(), "quaternion": [x, y, z, w]})
    assert_stands(taken(path, right, kind="stereo").siting, T)
    with pytest.raises(CalibrationFileError, match=r"whether a quaternion is in the order x, y, z, w"):
        taken(path, yaml.safe_dump({"translation": T[:3, 3].tolist(), "quaternion": [w, x, y, z]}), kind="stereo")


@pytest.mark.parametrize(
    ("down_deg", "roll_deg", "warning"),
    [
        (15.0, 0.0, None),
        (-4.0, -40.0, None),
        (88.0, 170.0, None),
        (-6.0, 0.0, "the sensor would look 6 deg up: if it is not so"),
        (-44.0, 0.0, "the sensor would look 44 deg up: if it is not so"),
        (15.0, 60.0, "the sensor would be rolled 60 deg: if it is not so"),
        (15.0, -89.0, "the sensor would be rolled 89 deg: if it is not so"),
    ],
)
def test_of_cameras_as_few_are_mounted_is_warned(
    tmp_path: Path, down_deg: float, roll_deg: float, warning: str | None
) -> None:
    T = camera(114.7, down_deg, roll_deg)
    imported = taken(tmp_path / "T.txt", rows(T), kind="stereo")
    assert_stands(imported.siting, T)
    said = [note for note in imported.notes if "the rotation is transposed" in note]
    assert bool(said) == (warning is not None)
    assert warning is None or said[0].startswith(warning)


@pytest.mark.parametrize(
    ("tilt_deg", "warned"), [(0.0, False), (44.0, False), (46.0, True), (134.0, True), (136.0, False), (180.0, False)]
)
def test_of_lidars_that_are_neither_upright_nor_upside_down_is_warned(
    tmp_path: Path, tilt_deg: float, warned: bool
) -> None:
    T = LIDAR.T_utm_sensor
    T[:3, :3] = Rotation.from_euler("ZX", [114.7, tilt_deg], degrees=True).as_matrix()
    imported = taken(tmp_path / "T.txt", rows(T), direction="sensor-to-map")
    assert_stands(imported.siting, T)
    assert any("would be tilted 46 deg: if it is not so, its axes" in note for note in imported.notes) == warned


def test_of_several_publishers_none_is_taken(tmp_path: Path) -> None:
    one = f"static_transform_publisher {by_position(T_NEAR, 'map', 'lidar', True)} 100\n"
    for other in (one, by_name(T_NEAR, "map", "lidar")):
        with pytest.raises(CalibrationFileError, match="it starts several static_transform_publisher; needed is"):
            taken(tmp_path / "both.launch", one + other, origin=NEAR_ORIGIN)


def scaled(factor: float) -> FloatArray:
    return np.diag([factor] * 3 + [1.0]) @ T_MAP


def turned(T_wrong: FloatArray, change: Callable[[FloatArray], None]) -> FloatArray:
    T_wrong = T_wrong.copy()
    change(T_wrong)
    return T_wrong


WRONG = {
    rows(turned(T_MAP, lambda m: m[:3, 0].__imul__(-1.0))): r"the rotation of matrix mirrors \(determinant -1\)",
    rows(turned(T_MAP, lambda m: m[0, :3].__imul__(1.3))): "the rotation of matrix is none",
    rows(scaled(1000.0)): r"the rotation of matrix is scaled by 1000",
    rows(T_MAP.T): r"matrix is transposed, its last column is 0 0 0 1",
    rows(turned(T_MAP, lambda m: m[3].__iadd__(0.5))): "the last row of matrix is",
    rows(T_MAP[:, :3]): "holds 12 numbers|the rotation of matrix|the last row",
    rows(np.eye(3)): "it holds 9 numbers; needed are the 16",
    rows(turned(T_MAP, lambda m: m[:3, 3].__imul__(1000.0))): r"the sensor would stand at UTM",
    yaml.safe_dump({**XYZ, "roll": 0.0, "pitch": 3.0, "yaw": 114.7}): r"an angle of roll is 114\.7; .* in degrees\?",
    yaml.safe_dump({**XYZ, "roll_deg": 0.0, "pitch_deg": 3.0, "yaw_deg": 1147.0}): r"roll is 1147; needed are degrees",
    yaml.safe_dump(
        {"t": T.tolist(), "q": [0.1, 0.2, 0.3, 0.4]}
    ): r"the quaternion of q has the norm 0\.547723; needed is 1",
    yaml.safe_dump({"t": T.tolist(), "rvec": [0.0, 90.0, 0.0]}): r"the rotation vector of rvec has the length 90",
    yaml.safe_dump({"camera_matrix": [1.0, 2.0], "name": "left"}): "it holds no transform; needed are 16 numbers",
    rows(invert(T_MAP)): "needed is --direction map-to-sensor|above the ground",
    "+proj=pipeline +step +proj=affine +s11=2": "the affine step stretches by 2 1 1",
    "+proj=pipeline +step +proj=utm +zone=32 +step +proj=affine": "other steps than one",
    "1 " * 11 + "\u2028": "it holds 11 numbers",
    "{": "it is neither a matrix nor YAML, JSON or XML",
    "": "is empty",
}


@pytest.mark.parametrize(("text", "message"), WRONG.items(), ids=[str(i) for i in range(len(WRONG))])
def test_what_is_wrong_is_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(CalibrationFileError, match=message) as refused:
        taken(tmp_path / "mast.txt", text, origin=ORIGIN)
    assert len(str(refused.value).splitlines()) == 1
    assert "mast.txt" in str(refused.value)


@pytest.mark.parametrize("shift", [1e400, -1e400, float("nan"), 1e300])
def test_a_correction_beyond_measure_is_refused(tmp_path: Path, shift: float) -> None:
    exported(tmp_path, STEREO, "dair")
    path = tmp_path / "virtuallidar_to_world.json"
    document = json.loads(path.read_text())
    document["relative_error"] = {"delta_x": shift, "delta_y": 0.0}
    path.write_text(json.dumps(document))
    with pytest.raises(CalibrationFileError, match="needed are metres"):
        import_pose(tmp_path, ImportOptions(kind="stereo", crs="EPSG:32632"))


@pytest.mark.parametrize("told", ["kind", "crs"])
def test_what_a_file_says_at_length_is_quoted_in_short(tmp_path: Path, told: str) -> None:
    path = exported(tmp_path, STEREO, "kitti")
    text = path.read_text()
    word = {"kind": '"stereo"', "crs": '"EPSG:32632"'}[told]
    assert word in text
    path.write_text(text.replace(word, f'"{"x" * 5000}"'))
    for options in (ImportOptions(), ImportOptions(kind="stereo", crs="EPSG:32632")):
        with pytest.raises(InputError, match="xxx") as refused:
            import_pose(path, options)
        assert len(str(refused.value)) < 1000


def test_a_transform_the_wrong_way_round_is_recognised(tmp_path: Path) -> None:
    path = tmp_path / "T.txt"
    with pytest.raises(CalibrationFileError, match="upright; needed is --direction sensor-to-map"):
        taken(path, rows(LIDAR.T_utm_sensor), direction="map-to-sensor")
    with pytest.raises(CalibrationFileError, match="upright; needed is --direction map-to-sensor"):
        taken(path, rows(invert(LIDAR.T_utm_sensor)))


def test_what_is_asked_for_stands_above_what_a_name_means_to_us(tmp_path: Path) -> None:
    """Others call the way from b to a T_b_a."""
    path = tmp_path / "T.json"
    with pytest.raises(CalibrationFileError, match="needed is --direction sensor-to-map"):
        taken(path, json.dumps({"T_lidar_map": LIDAR.T_utm_sensor.tolist()}))
    found = taken(path, direction="sensor-to-map").siting
    assert_stands(found, LIDAR.T_utm_sensor)


def test_millimetres_are_recognised(tmp_path: Path) -> None:
    T_utm = LIDAR.T_utm_sensor.copy()
    T_utm[:3, 3] *= 1000.0
    with pytest.raises(CalibrationFileError, match=r"needed are UTM coordinates in metres: is it in millimetres\?"):
        taken(tmp_path / "T.txt", rows(T_utm))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"crs": None}, r"does not say its UTM zone; needed is --crs EPSG:326\.\."),
        ({"kind": None}, r"does not say the sensor's kind; needed is --kind stereo or lidar"),
        ({"crs": "EPSG:4326"}, "'EPSG:4326' is WGS 84; needed is a UTM zone such as EPSG:32632"),
        ({"crs": "Ulm"}, "'Ulm' is not known to PROJ"),
        ({"origin": None}, "needed are UTM coordinates in metres, --origin E,N"),
    ],
)
def test_what_the_file_does_not_say_is_asked_for(tmp_path: Path, options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        taken(tmp_path / "T.txt", rows(T_MAP), **{"origin": ORIGIN, **options})


def test_what_file_and_option_say_must_agree(tmp_path: Path) -> None:
    path = exported(tmp_path, LIDAR, "matrix")
    with pytest.raises(SettingError, match="the sensor's kind is lidar, the option stereo"):
        import_pose(path, ImportOptions(kind="stereo"))
    with pytest.raises(SettingError, match=r"its UTM zone is EPSG:32632, the option EPSG:32633"):
        import_pose(path, ImportOptions(crs="EPSG:32633"))


@pytest.mark.parametrize("form", ["ros2", "matrix"])
def test_an_origin_that_the_file_states_is_not_overridden(tmp_path: Path, form: str) -> None:
    """The map of exports in UTM begins at its 0, 0, that of the others at a place which they tell."""
    path = exported(tmp_path, LIDAR, form)
    stated = LIDAR.world.origin_utm if form == "ros2" else (0.0, 0.0)
    plain = import_pose(path, ImportOptions()).siting
    for same in (stated, (*stated, 0.0)):
        found = import_pose(path, ImportOptions(origin=same)).siting
        np.testing.assert_array_equal(found.T_world_sensor, plain.T_world_sensor)
    for other in ((stated[0] + 1.0, stated[1]), (*stated, 478.0)):
        with pytest.raises(
            SettingError, match=r"says that its map begins at UTM .* needed is --origin as the file"
        ) as no:
            import_pose(path, ImportOptions(origin=other))
        assert len(str(no.value).splitlines()) == 1


@pytest.mark.parametrize("form", [each.name for each in FORMATS if each.name != "proj"])
@pytest.mark.parametrize("rectified", [False, True])
def test_a_camera_of_rectified_images_stays_one(tmp_path: Path, form: str, rectified: bool) -> None:
    path = exported(tmp_path, replace(STEREO, frame=RECTIFIED_FRAME if rectified else RAW_FRAME), form)
    imported = import_pose(path, ImportOptions())
    result = tmp_path / "result.json"
    result.write_text(to_text(imported_document(imported, {}, {})))
    stored = read_calibration(result)
    assert stored.rectified == rectified


def test_of_foreign_files_the_user_says_that_images_are_rectified(tmp_path: Path) -> None:
    path = tmp_path / "T.txt"
    assert taken(path, rows(STEREO.T_utm_sensor), kind="stereo").siting.frame.startswith("raw left camera")
    found = taken(path, kind="stereo", rectified=True).siting
    assert found.frame == RECTIFIED_FRAME
    with pytest.raises(SettingError, match="the sensor is lidar; needed is a stereo camera of rectified images"):
        taken(path, kind="lidar", rectified=True)
    with pytest.raises(SettingError, match="the sensor is stereo, its frame 'as it is: x, y, z'; needed is"):
        import_pose(exported(tmp_path, STEREO, "opencv"), ImportOptions(rectified=True))


@pytest.mark.parametrize("crs", ["EPSG:25832", "epsg:32632", "WGS 84 / UTM zone 32N"])
def test_any_utm_zone_goes_into_a_result(tmp_path: Path, crs: str) -> None:
    imported = taken(tmp_path / "T.txt", rows(LIDAR.T_utm_sensor), crs=crs)
    (tmp_path / "result.json").write_text(to_text(imported_document(imported, {}, {})))
    stored = read_calibration(tmp_path / "result.json")
    assert stored.world.crs == ("EPSG:25832" if crs == "EPSG:25832" else "EPSG:32632")
    assert_stands(stored, LIDAR.T_utm_sensor)


def test_a_camera_in_axes_of_a_body_is_refused(tmp_path: Path) -> None:
    """A camera's pose as x forward, y left, z up puts its line of sight where up is."""
    forward_left_up = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    T = SITINGS[0].T_utm_sensor
    T[:3, :3] = T[:3, :3] @ forward_left_up.T
    with pytest.raises(CalibrationFileError, match=r"look [5-9]\d deg up; needed is the pose of its optical frame"):
        taken(tmp_path / "T.txt", rows(T), kind="stereo")


def test_of_two_files_that_make_a_camera_one_is_refused(tmp_path: Path) -> None:
    folder = exported(tmp_path, SITINGS[0], "dair")
    with pytest.raises(CalibrationFileError, match=r"90 deg up; needed .* the folder with both files"):
        import_pose(folder / "virtuallidar_to_world.json", ImportOptions())


@pytest.mark.parametrize("centre", [(9.94, 48.42), (5363000.0, 569000.0)], ids=["degrees", "swapped"])
def test_a_centre_far_from_the_sensor_is_refused(tmp_path: Path, centre: tuple[float, float]) -> None:
    path = exported(tmp_path, LIDAR, "matrix")
    with pytest.raises(
        SettingError, match=r"--centre is .* m from the sensor; needed are UTM coordinates within 1000 m"
    ):
        import_pose(path, ImportOptions(centre=centre))


def test_a_result_needs_no_import(tmp_path: Path) -> None:
    imported = taken(exported(tmp_path, LIDAR, "matrix"))
    folder = tmp_path / "result"
    folder.mkdir()
    (folder / "calibration.json").write_text(to_text(imported_document(imported, {}, {})))
    for path in (folder, folder / "calibration.json"):
        with pytest.raises(CalibrationFileError, match="is a result already; needed is a file of another tool"):
            import_pose(path, ImportOptions())


def test_rounded_numbers_are_brought_to_the_nearest_rotation(tmp_path: Path) -> None:
    found = taken(
        tmp_path / "T.txt", "\n".join(" ".join(f"{value:.3f}" for value in row) for row in LIDAR.T_utm_sensor)
    ).siting.T_world_sensor[:3, :3]
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(found, LIDAR.T_world_sensor[:3, :3], atol=1e-3)


@pytest.mark.parametrize("form", [each.name for each in FORMATS if each.name != "dair"])
def test_any_file_is_read_or_refused(tmp_path: Path, form: str) -> None:
    whole = exported(tmp_path, LIDAR, form).read_bytes()
    path = tmp_path / "any"

    @fuzz
    @given(
        st.one_of(mutations(whole), noise("R:", "T:", "{", "}", "[", "]", ": ", "\n", "1 0 0 ", "rotation", "- ", ","))
    )
    def check(content: bytes) -> None:
        path.write_bytes(content)
        found = read_or_refused(lambda: import_pose(path, ImportOptions(kind="lidar", crs="EPSG:32632")), InputError)
        assert found is None or np.isfinite(found.siting.T_utm_sensor).all()

    check()


@pytest.mark.parametrize(
    "text",
    [
        "1" * 200_000,
        "1 " * 200_000,
        "a: " + "[" * 50_000,
        "\n" * 200_000 + "x",
        "<!DOCTYPE a [<!ENTITY b 'c'>]><a/>",
        "1e999 " * 16,
        "T: " + "1 " * 100_000,
        "--x " * 50_000 + "static_transform_publisher",
        "static_transform_publisher " + "1 " * 100_000 + "map lidar",
        "static_transform_publisher 1 2 3 0 0 0 lidar map" + "1" * 100_000 + "-",
        "static_transform_publisher 1 2 3 0 0 0 lidar " + "map/" * 50_000 + "-",
        "T_" * 100_000 + "map: [" + "1, " * 16 + "]",
    ],
    ids=range(12),
)
def test_large_and_malicious_files_are_refused_soon(tmp_path: Path, text: str) -> None:
    with pytest.raises(CalibrationFileError):
        taken(tmp_path / "any", text)


@needs_shared
def test_the_shared_sensor_kit() -> None:
    path = SHARED / "formats/extrinsics/autoware_sensor_kit_calibration.yaml"
    with pytest.raises(CalibrationFileError, match=r"2 transforms, sensor_kit_base_link/camera_top/camera_link"):
        taken(path)
    found = taken(path, entry="sensor_kit_base_link/velodyne_left_base_link", origin=ORIGIN).siting.T_utm_sensor
    assert found[:3, 3] == pytest.approx([ORIGIN[0] - 0.209462, ORIGIN[1] + 1.27408, 0.42718])
    turn = Rotation.from_euler("xyz", [0.11323573304824952, -0.15690236136798336, -0.5679267064422931])
    np.testing.assert_allclose(found[:3, :3], turn.as_matrix(), atol=1e-12)


def test_worlds_lie_where_they_are_said_to() -> None:
    assert (ULM.crs, FIJI.crs) == ("EPSG:32632", "EPSG:32701")
