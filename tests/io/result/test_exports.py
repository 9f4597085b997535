"""What is exported puts points where the calibration puts them, read by the software that it is for."""

from __future__ import annotations

import json
import re
import shlex
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from jsonschema import Draft7Validator
from pyproj import Transformer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from laci_stereo.core.errors import SettingError
from laci_stereo.core.frames import FloatArray, invert, rigid, transform
from laci_stereo.io.result.exports import FORMATS, export_as, frame_id
from laci_stereo.io.result.siting import Siting
from tests.io.sitings import SITINGS, siting, ten_points

MILLIMETRE = 1e-3

every_siting = pytest.mark.parametrize("sited", SITINGS, ids=[each.kind + each.world.crs[-5:] for each in SITINGS])


def only(sited: Siting, form: str) -> str:
    (file,) = export_as(sited, form)
    return file.text


def assert_same_places(sited: Siting, found_utm: FloatArray) -> None:
    np.testing.assert_allclose(found_utm, transform(sited.T_utm_sensor, ten_points()), rtol=0, atol=MILLIMETRE)


def in_utm(sited: Siting, points_map: FloatArray) -> FloatArray:
    return points_map + np.array([*sited.world.origin_utm, 0.0])


@every_siting
def test_matrix_is_read_by_numpy(sited: Siting, tmp_path: Path) -> None:
    (file,) = export_as(sited, "matrix")
    (tmp_path / file.name).write_text(file.text)
    assert_same_places(sited, transform(np.loadtxt(tmp_path / file.name), ten_points()))


@every_siting
def test_opencv_reads_its_file_and_projects_points_of_the_map(sited: Siting, tmp_path: Path) -> None:
    path = tmp_path / "extrinsics.yaml"
    path.write_text(only(sited, "opencv"))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    T, rvec, tvec, origin = (storage.getNode(key).mat() for key in ("T_map_sensor", "rvec", "tvec", "origin_utm"))
    assert storage.getNode("crs").string() == sited.world.crs
    assert origin.ravel().tolist() == list(sited.world.origin_utm)
    assert_same_places(sited, in_utm(sited, transform(T, ten_points())))
    ahead = np.abs(ten_points()) + 5.0
    K = np.diag([500.0, 500.0, 1.0])
    pixels, _ = cv2.projectPoints(transform(T, ahead), rvec, tvec, K, np.zeros(5))
    np.testing.assert_allclose(pixels[:, 0], 500.0 * ahead[:, :2] / ahead[:, 2:], atol=1e-6)


@every_siting
def test_ros2_launch_file_starts_the_publisher_of_the_transform(sited: Siting) -> None:
    """ROS 2 reads a launch file in YAML by yaml.safe_load, and splits the arguments as a shell does.

    A list of entities, each with its type alone as key; a dollar sign would begin a substitution. The publisher takes
    its options in any order, each once, and a turn either as a quaternion or as angles.
    """
    document = yaml.safe_load(only(sited, "ros2"))
    assert list(document) == ["launch"]
    (entity,) = document["launch"]
    assert list(entity) == ["node"]
    node = entity["node"]
    assert set(node) <= {"pkg", "exec", "name", "namespace", "args", "ros_args", "output", "respawn"}
    assert all(isinstance(value, str) and "$" not in value for value in node.values())
    assert (node["pkg"], node["exec"]) == ("tf2_ros", "static_transform_publisher")
    assert re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", node["name"])
    words = shlex.split(node["args"])
    told = dict(zip(words[::2], words[1::2], strict=True))
    assert len(words) == 2 * len(told)
    assert set(told) == {f"--{name}" for name in ("x", "y", "z", "qx", "qy", "qz", "qw", "frame-id", "child-frame-id")}
    assert (told["--frame-id"], told["--child-frame-id"]) == ("map", frame_id(sited))
    assert re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", frame_id(sited))
    types = get_typestore(Stores.ROS2_HUMBLE).types
    place = types["geometry_msgs/msg/Vector3"](*(float(told[f"--{axis}"]) for axis in "xyz"))
    turn = types["geometry_msgs/msg/Quaternion"](*(float(told[f"--q{axis}"]) for axis in "xyzw"))
    sent = types["geometry_msgs/msg/Transform"](translation=place, rotation=turn)
    rotation = Rotation.from_quat([sent.rotation.x, sent.rotation.y, sent.rotation.z, sent.rotation.w])
    T = rigid(rotation.as_matrix(), np.array([sent.translation.x, sent.translation.y, sent.translation.z]))
    assert_same_places(sited, in_utm(sited, transform(T, ten_points())))
    # Viewers hold what comes of it in 32 bits, which near a whole-metre origin costs nothing.
    assert np.abs(T[:3, 3]).max() < 1000.0


@every_siting
def test_autoware_angles_are_those_of_urdf(sited: Siting) -> None:
    document = yaml.safe_load(only(sited, "autoware"))
    pose = document["map"][frame_id(sited)]
    assert list(pose) == ["x", "y", "z", "roll", "pitch", "yaw"]
    about = [
        Rotation.from_rotvec(pose[key] * axis) for key, axis in zip(("roll", "pitch", "yaw"), np.eye(3), strict=True)
    ]
    T = rigid((about[2] * about[1] * about[0]).as_matrix(), np.array([pose["x"], pose["y"], pose["z"]]))
    assert_same_places(sited, in_utm(sited, transform(T, ten_points())))


@every_siting
def test_openlabel_fits_the_standards_schema(sited: Siting) -> None:
    document = json.loads(only(sited, "openlabel"))
    schema = json.loads(files("kognic.openlabel.schemas").joinpath("openlabel-1-0-0.json").read_text())
    assert list(Draft7Validator(schema).iter_errors(document)) == []
    label = document["openlabel"]
    name = frame_id(sited)
    assert label["coordinate_systems"]["map"]["children"] == [name]
    assert label["streams"][name]["type"] == {"stereo": "camera", "lidar": "lidar"}.get(sited.kind, "other")
    T = np.reshape(label["coordinate_systems"][name]["pose_wrt_parent"]["matrix4x4"], (4, 4))
    assert_same_places(sited, in_utm(sited, transform(T, ten_points())))


@every_siting
def test_kitti_entries_are_numbers_and_the_others_are_passed_over(sited: Siting) -> None:
    entries = {}
    for line in only(sited, "kitti").splitlines():  # as KITTI's readers do it
        key, value = line.split(":", 1)
        try:
            entries[key] = np.array([float(word) for word in value.split()])
        except ValueError:
            continue
    assert set(entries) == {"R", "T", "Tr_sensor_to_map"}
    T = rigid(entries["R"].reshape(3, 3), entries["T"])
    np.testing.assert_array_equal(T[:3].ravel(), entries["Tr_sensor_to_map"])
    assert_same_places(sited, in_utm(sited, transform(T, ten_points())))


@every_siting
def test_dair_leads_over_a_level_frame_to_the_camera(sited: Siting) -> None:
    found = {file.name: json.loads(file.text) for file in export_as(sited, "dair")}
    T_world_virtual = of_dair(found["virtuallidar_to_world.json"])
    if sited.kind != "stereo":
        assert len(found) == 1
        assert_same_places(sited, transform(T_world_virtual, ten_points()))
        return
    T_camera_virtual = of_dair(found["virtuallidar_to_camera.json"])
    assert_same_places(sited, transform(T_world_virtual @ invert(T_camera_virtual), ten_points()))
    np.testing.assert_allclose(T_world_virtual[2, :3], [0, 0, 1], atol=1e-12)
    forward_virtual = T_camera_virtual[2, :3]  # of the camera: above the virtual LiDAR's x
    assert abs(forward_virtual[1]) < 1e-9
    assert forward_virtual[0] > 0


def of_dair(document: dict[str, object]) -> FloatArray:
    error = document.get("relative_error", {"delta_x": 0.0, "delta_y": 0.0})
    assert error == {"delta_x": 0.0, "delta_y": 0.0}
    T = np.eye(4)
    T[:3, :3] = document["rotation"]
    T[:3, 3:] = document["translation"]
    return T


@every_siting
def test_proj_pipeline_is_exact_everywhere_for_it_holds_the_grids_scale(sited: Siting) -> None:
    pipeline = Transformer.from_pipeline(only(sited, "proj"))
    x, y, z = ten_points().T.tolist()
    found = np.array(pipeline.transform(x, y, z)).T
    points_world = transform(sited.T_world_sensor, ten_points())
    wanted = np.column_stack([sited.world.to_utm(points_world[:, :2]), points_world[:, 2]])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=MILLIMETRE)
    back = np.array(pipeline.transform(*found.T.tolist(), direction="INVERSE")).T
    np.testing.assert_allclose(back, ten_points(), rtol=0, atol=MILLIMETRE)


def test_rigid_transform_is_off_by_the_grids_scale_and_says_by_how_much() -> None:
    sited = siting()
    away = transform(invert(sited.T_world_sensor), (sited.centre_world + np.array([100.0, 0.0, 0.0]))[None])
    rigidly = transform(sited.T_utm_sensor, away)[0, :2]
    truly = sited.world.to_utm(sited.centre_world[None, :2] + [100.0, 0.0])[0]
    off_cm = 100.0 * float(np.linalg.norm(rigidly - truly))
    assert f" {off_cm:.1f} cm off at 100 m" in only(sited, "matrix")
    centre = transform(invert(sited.T_world_sensor), sited.centre_world[None])
    np.testing.assert_allclose(
        transform(sited.T_utm_sensor, centre)[0, :2], sited.world.to_utm(sited.centre_world[None, :2])[0], atol=1e-8
    )


@pytest.mark.parametrize("form", [each.name for each in FORMATS])
@every_siting
def test_every_file_tells_system_and_origin(sited: Siting, form: str) -> None:
    for file in export_as(sited, form):
        if file.name == "virtuallidar_to_camera.json":  # which leads nowhere in the map
            continue
        assert sited.world.crs in file.text
        assert "metres" in file.text
        if form != "proj":  # which is a string of PROJ's, with room for a title only
            assert "direction" in file.text
            assert "height over the ground" in file.text


def test_an_unknown_format_is_refused_with_those_there_are() -> None:
    with pytest.raises(SettingError, match=r"--to is 'svg'; needed is one of matrix, opencv, ros2"):
        export_as(siting(), "svg")
