"""Writes one stereo rig in the formats of the tools that make them, by their own libraries where there are such."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from laci_stereo.io.rig.stereo_rig import Lens, StereoRig
from laci_stereo.stereo.rectify import bouguet

Write = Callable[[Path, StereoRig], tuple[Path, ...]]
MODEL_NAMES = {"pinhole": "radtan", "fisheye": "equidistant"}


def write_storage(path: Path, entries: dict[str, object]) -> Path:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in entries.items():
        storage.write(name, value)
    storage.release()
    return path


def write_yaml(path: Path, entries: object, flow: bool | None = None) -> Path:
    path.write_text(yaml.safe_dump(entries, default_flow_style=flow), encoding="utf-8")
    return path


def write_json(path: Path, entries: object) -> Path:
    path.write_text(json.dumps(entries), encoding="utf-8")
    return path


def opencv_entries(rig: StereoRig) -> dict[str, object]:
    named = {"model": "fisheye"} if rig.left.model == "fisheye" else {}
    return {
        "image_width": rig.left.size[0],
        "image_height": rig.left.size[1],
        **named,
        "K1": rig.left.K,
        "D1": rig.left.distortion,
        "K2": rig.right.K,
        "D2": rig.right.distortion,
        "R": rig.R_right_left,
        "T": rig.t_right_left_m,
    }


def opencv(suffix: str) -> Write:
    return lambda folder, rig: (write_storage(folder / f"stereo.{suffix}", opencv_entries(rig)),)


def opencv_npz(folder: Path, rig: StereoRig) -> tuple[Path, ...]:
    """Write what Python users keep of ``cv2.stereoCalibrate``, with the corners that they do not need any more."""
    path = folder / "stereo.npz"
    np.savez_compressed(path, corners=np.zeros((40, 54, 2)), rms=0.3, **opencv_entries(rig))
    return (path,)


def opencv_two(folder: Path, rig: StereoRig) -> tuple[Path, ...]:
    entries = opencv_entries(rig)
    outer = {name: entries.pop(name) for name in ("R", "T")}
    return write_storage(folder / "intrinsics.yml", entries), write_storage(folder / "extrinsics.yml", outer)


def opencv_sections(folder: Path, rig: StereoRig) -> tuple[Path, ...]:
    def section(lens: Lens) -> dict[str, object]:
        return {"K": lens.K.tolist(), "D": lens.distortion.tolist()}

    outer = {"rotation": rig.R_right_left.tolist(), "translation": rig.t_right_left_m.tolist()}
    entries = {"image_size": list(rig.left.size), "left": section(rig.left), "right": section(rig.right), "pose": outer}
    if rig.left.model == "fisheye":
        entries["model"] = "fisheye"
    return (write_yaml(folder / "stereo.yaml", entries),)


def ros(flow: bool | None) -> Write:
    def write(folder: Path, rig: StereoRig) -> tuple[Path, ...]:
        projections = bouguet(rig)
        models = {4: "equidistant" if rig.left.model == "fisheye" else "plumb_bob", 5: "plumb_bob"}
        paths = []
        for side, lens, R, P in (
            ("left", rig.left, projections[0], projections[2]),
            ("right", rig.right, projections[1], projections[3]),
        ):
            entries = {
                "image_width": lens.size[0],
                "image_height": lens.size[1],
                "camera_name": f"narrow_stereo/{side}",
                "camera_matrix": matrix(lens.K),
                "distortion_model": models.get(len(lens.distortion), "rational_polynomial"),
                "distortion_coefficients": matrix(lens.distortion[None]),
                "rectification_matrix": matrix(R),
                "projection_matrix": matrix(P),
            }
            paths.append(write_yaml(folder / f"{side}.yaml", entries, flow))
        return tuple(paths)

    return write


def ros_topic(folder: Path, rig: StereoRig) -> tuple[Path, ...]:
    """Write what ``ros2 topic echo --once`` prints."""
    projections = bouguet(rig)
    paths = []
    for side, lens, R, P in (
        ("left", rig.left, projections[0], projections[2]),
        ("right", rig.right, projections[1], projections[3]),
    ):
        entries = {
            "header": {"stamp": {"sec": 1700000000, "nanosec": 5}, "frame_id": side},
            "height": lens.size[1],
            "width": lens.size[0],
            "distortion_model": "equidistant" if lens.model == "fisheye" else "plumb_bob",
            "d": lens.distortion.tolist(),
            "k": lens.K.ravel().tolist(),
            "r": R.ravel().tolist(),
            "p": P.ravel().tolist(),
            "binning_x": 0,
            "roi": {"x_offset": 0, "do_rectify": False},
        }
        path = write_yaml(folder / f"{side}.yaml", entries, flow=False)
        path.write_text(path.read_text() + "---\n", encoding="utf-8")
        paths.append(path)
    return tuple(paths)


def matrix(values: np.ndarray) -> dict[str, object]:
    return {"rows": values.shape[0], "cols": values.shape[1], "data": values.ravel().tolist()}


def kalibr(flow: bool | None) -> Write:
    def write(folder: Path, rig: StereoRig) -> tuple[Path, ...]:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rig.R_right_left, rig.t_right_left_m
        cameras: dict[str, dict[str, object]] = {}
        for name, lens in (("cam0", rig.left), ("cam1", rig.right)):
            cameras[name] = {
                "camera_model": "pinhole",
                "cam_overlaps": [0],
                "distortion_coeffs": lens.distortion.tolist(),
                "distortion_model": MODEL_NAMES[lens.model],
                "intrinsics": intrinsics(lens),
                "resolution": list(lens.size),
                "rostopic": f"/{name}/image_raw",
            }
        cameras["cam1"]["T_cn_cnm1"] = T.tolist()
        return (write_yaml(folder / "camchain.yaml", cameras, flow),)

    return write


def intrinsics(lens: Lens) -> list[float]:
    return [float(lens.K[0, 0]), float(lens.K[1, 1]), float(lens.K[0, 2]), float(lens.K[1, 2])]


def numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.16e}" for value in np.ravel(values))


def kitti_raw(folder: Path, rig: StereoRig) -> tuple[Path, ...]:
    """Write four cameras of which the first two are the rig, seen from a frame of its own."""
    left_R, left_P, right_P = (bouguet(rig)[i] for i in (0, 2, 3))
    base = Rotation.from_euler("xyz", [1.0, -2.0, 3.0], degrees=True).as_matrix()
    shift = np.array([0.06, -0.01, 0.02])
    poses = ((base, shift), (rig.R_right_left @ base, rig.R_right_left @ shift + rig.t_right_left_m))
    lines = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.950000e-02"]
    for number in range(4):
        lens, (R, T) = ((rig.left, poses[0]), (rig.right, poses[1]))[number % 2]
        P = (left_P, right_P)[number % 2]
        lines += [
            f"S_0{number}: {numbers(lens.size)}",
            f"K_0{number}: {numbers(lens.K)}",
            f"D_0{number}: {numbers(lens.distortion)}",
            f"R_0{number}: {numbers(R)}",
            f"T_0{number}: {numbers(T)}",
            f"S_rect_0{number}: {numbers((lens.size[0] - 40, lens.size[1] - 30))}",
            f"R_rect_0{number}: {numbers(left_R)}",
            f"P_rect_0{number}: {numbers(P)}",
        ]
    path = folder / "calib_cam_to_cam.txt"
    path.write_text("\n".join(lines) + "\n")
    return (path,)


def matlab_struct(rig: StereoRig) -> dict[str, object]:
    def camera(lens: Lens) -> dict[str, object]:
        one_based = lens.K + np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
        k1, k2, p1, p2, *k3 = lens.distortion.tolist()
        return {
            "RadialDistortion": np.array([k1, k2, *k3]),
            "TangentialDistortion": np.array([p1, p2]),
            "ImageSize": np.array([lens.size[1], lens.size[0]]),
            "WorldUnits": "millimeters",
            "EstimateSkew": False,
            "IntrinsicMatrix": one_based.T,
            "WorldPoints": np.zeros((54, 2)),
        }

    return {
        "CameraParameters1": camera(rig.left),
        "CameraParameters2": camera(rig.right),
        "RotationOfCamera2": rig.R_right_left.T,
        "TranslationOfCamera2": 1000.0 * rig.t_right_left_m,
        "Version": {"Name": "MATLAB", "Release": "(R2021b)"},
    }


def matlab(compressed: bool) -> Write:
    def write(folder: Path, rig: StereoRig) -> tuple[Path, ...]:
        path = folder / "stereo.mat"
        savemat(path, {"s": matlab_struct(rig), "other": np.arange(3)}, do_compression=compressed)
        return (path,)

    return write


def matlab_pose(folder: Path, rig: StereoRig) -> tuple[Path, ...]:
    """Write the newer form: K, and the pose as a matrix to multiply columns with."""
    struct = matlab_struct(rig)
    for name in ("CameraParameters1", "CameraParameters2"):
        camera = struct[name]
        assert isinstance(camera, dict)
        camera["K"] = np.transpose(camera.pop("IntrinsicMatrix"))
    A = np.eye(4)
    A[:3, :3], A[:3, 3] = rig.R_right_left, 1000.0 * rig.t_right_left_m
    del struct["RotationOfCamera2"], struct["TranslationOfCamera2"]
    path = folder / "stereo.mat"
    savemat(path, {"s": {**struct, "PoseCamera2": {"Dimensionality": 3, "A": A}}})
    return (path,)


def matlab_json(folder: Path, rig: StereoRig) -> tuple[Path, ...]:
    plain = json.loads(json.dumps(matlab_struct(rig), default=lambda value: value.tolist()))
    return (write_json(folder / "stereo.json", plain),)


def basalt(folder: Path, rig: StereoRig) -> tuple[Path, ...]:
    def camera(lens: Lens) -> dict[str, object]:
        k = lens.distortion.tolist()
        names = {"fisheye": ("k1", "k2", "k3", "k4"), "pinhole": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")}
        k += [0.0] * (len(names[lens.model]) - len(k))
        fx, fy, cx, cy = intrinsics(lens)
        values = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, **dict(zip(names[lens.model], k, strict=True))}
        kind = "kb4" if lens.model == "fisheye" else "pinhole-radtan8"
        return {"camera_type": kind, "intrinsics": values}

    base = Rotation.from_euler("xyz", [80.0, 5.0, -3.0], degrees=True)
    shift = np.array([0.1, 0.2, -0.05])
    # p_imu = base p_left + shift, and p_left = R^T (p_right - t).
    right = base * Rotation.from_matrix(rig.R_right_left).inv()
    poses = ((base, shift), (right, shift - right.apply(rig.t_right_left_m)))
    listed = [
        dict(zip(("px", "py", "pz", "qx", "qy", "qz", "qw"), [*t.tolist(), *R.as_quat().tolist()], strict=True))
        for R, t in poses
    ]
    value = {
        "T_imu_cam": listed,
        "intrinsics": [camera(rig.left), camera(rig.right)],
        "resolution": [list(rig.left.size), list(rig.right.size)],
        "calib_accel_bias": [0.0] * 9,
    }
    return (write_json(folder / "calibration.json", {"value0": value}),)


def depthai(folder: Path, rig: StereoRig) -> tuple[Path, ...]:
    """Write a colour camera in socket 0 and the rig in 1 and 2; left tells where right is, right where colour is."""
    third = Rotation.from_euler("xyz", [0.3, 0.2, 0.1], degrees=True).as_matrix()

    def camera(lens: Lens, R: np.ndarray, t_m: np.ndarray, socket: int) -> list[object]:
        cm = dict(zip("xyz", (100.0 * t_m).tolist(), strict=True))
        entries = {
            "cameraType": 1 if lens.model == "fisheye" else 0,
            "distortionCoeff": [*lens.distortion.tolist(), *[0.0] * (14 - len(lens.distortion))],
            "extrinsics": {
                "rotationMatrix": R.tolist(),
                "specTranslation": {"x": -7.5, "y": 0.0, "z": 0.0},
                "toCameraSocket": socket,
                "translation": cm,
            },
            "height": lens.size[1],
            "width": lens.size[0],
            "intrinsicMatrix": lens.K.tolist(),
            "lensPosition": 0,
        }
        return [entries]

    nowhere = (np.eye(3), np.zeros(3), -1)
    cameras = [
        [0, *camera(rig.left, *nowhere)],
        [1, *camera(rig.left, rig.R_right_left, rig.t_right_left_m, 2)],
        [2, *camera(rig.right, third, np.array([0.0375, 0.0, 0.0]), 0)],
    ]
    told = {"leftCameraSocket": 1, "rightCameraSocket": 2, "rectifiedRotationLeft": np.eye(3).tolist()}
    return (write_json(folder / "oak.json", {"cameraData": cameras, "stereoRectificationData": told, "version": 7}),)


def zed(folder: Path, rig: StereoRig, mode: str = "HD") -> Path:
    """Write a ZED's file for one resolution, and another one's sections with nonsense in them."""

    def section(title: str, entries: Mapping[str, object]) -> str:
        return "\n".join([f"[{title}]", *(f"{name}={value}" for name, value in entries.items())]) + "\n"

    def distortion(lens: Lens) -> dict[str, object]:
        names = "k1 k2 k3 k4" if lens.model == "fisheye" else "k1 k2 p1 p2 k3 k4 k5 k6"
        return dict(zip(names.split(), lens.distortion.tolist(), strict=False))

    parts = []
    for side, lens in (("LEFT", rig.left), ("RIGHT", rig.right)):
        of_lens = dict(zip(("fx", "fy", "cx", "cy"), intrinsics(lens), strict=True))
        in_section = len(lens.distortion) == 5
        parts.append(section(f"{side}_CAM_{mode}", {**of_lens, **(distortion(lens) if in_section else {})}))
        parts.append(section(f"{side}_CAM_XYZ", {"fx": 1}))
        if not in_section:
            parts.append(section(f"{side}_DISTO", distortion(lens)))
    turn = Rotation.from_matrix(rig.R_right_left).as_rotvec().tolist()
    x, y, z = (1000.0 * rig.t_right_left_m).tolist()
    turns = dict(zip((f"RX_{mode}", f"CV_{mode}", f"RZ_{mode}"), turn, strict=True))
    parts.append(section("STEREO", {"Baseline": -x, "TY": y, "TZ": z, "RX_XYZ": 9, **turns}))
    (folder / "SN1.conf").write_text("\n".join([*parts, section("MISC", {"Sensor_ID": 1, "name": "a ZED"})]))
    return folder / "SN1.conf"


@dataclass(frozen=True)
class Format:
    """How to write a format, and which of the rigs of tests/stereo/rigs.py it can hold."""

    write: Write
    rigs: tuple[str, ...]


ANY = ("five", "eight", "twelve", "askew", "mirrored askew", "fisheye")
FORMATS: dict[str, Format] = {
    "opencv yaml": Format(opencv("yaml"), ANY),
    "opencv json": Format(opencv("json"), ("five", "fisheye")),
    "opencv xml": Format(opencv("xml"), ("five", "fisheye")),
    "opencv npz": Format(opencv_npz, ("five", "eight", "askew")),
    "opencv two files": Format(opencv_two, ANY),
    "opencv sections": Format(opencv_sections, ("five", "fisheye")),
    "ros": Format(ros(None), ("five", "eight", "mirrored askew", "fisheye")),
    "ros block": Format(ros(False), ("five",)),
    "ros topic": Format(ros_topic, ("five", "fisheye")),
    "kalibr": Format(kalibr(None), ("four", "fisheye")),
    "kalibr block": Format(kalibr(False), ("four",)),
    "kitti raw": Format(kitti_raw, ("five",)),
    "matlab": Format(matlab(False), ("four", "five")),
    "matlab compressed": Format(matlab(True), ("five",)),
    "matlab pose": Format(matlab_pose, ("five",)),
    "matlab json": Format(matlab_json, ("five",)),
    "basalt": Format(basalt, ("five", "eight", "fisheye")),
    "depthai": Format(depthai, ("five", "eight", "twelve", "fisheye")),
}
