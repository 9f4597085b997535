from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

from laci_stereo.core.errors import RigError
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.rig.mat_file import LARGEST_UNPACKED
from laci_stereo.io.rig.stereo_calibration import calibration_files, read_rig, read_stereo_calibration
from laci_stereo.io.rig.stereo_rig import ForImages, StereoRig
from laci_stereo.io.rig.syntax import LARGEST_FILE
from laci_stereo.stereo.rectify import already_rectified, bouguet, rectify
from tests.io import rig_writers as writers
from tests.io.support import SHARED, fuzz, mutations, needs_shared, noise, read_or_refused
from tests.stereo import rigs

FOUR = (-0.25, 0.08, 1e-3, -8e-4)
RIGS = {**rigs.RIGS, "four": rigs.rig(rigs.lens(FOUR), rigs.lens(FOUR, shift=(3.0, -2.0)), (0.2, -0.3, 0.1))}
CASES = [(name, rig) for name, form in writers.FORMATS.items() for rig in form.rigs]
FAMOUS = SHARED / "formats/stereo"


def maps(rig: StereoRig) -> list[FloatArray]:
    """Return where each pixel of the rectified images is in the raw ones, columns and rows of both cameras."""
    left_R, right_R, left_P, right_P = bouguet(rig)
    found = []
    for lens, R, P in ((rig.left, left_R, left_P), (rig.right, right_R, right_P)):
        init = cv2.fisheye.initUndistortRectifyMap if lens.model == "fisheye" else cv2.initUndistortRectifyMap
        found += list(init(lens.K, lens.distortion, R, P[:, :3], rig.left.size, cv2.CV_32FC1))
    return found


@pytest.mark.parametrize(("form", "name"), CASES)
def test_every_format_gives_the_same_rectification(tmp_path: Path, form: str, name: str) -> None:
    rig = RIGS[name]
    read = read_stereo_calibration(writers.FORMATS[form].write(tmp_path, rig), rig.left.size)
    assert (read.left.size, read.right.size, read.left.model) == (rig.left.size, rig.right.size, rig.left.model)
    np.testing.assert_allclose(read.t_right_left_m, rig.t_right_left_m, atol=1e-9)
    for found, expected in zip(maps(read), maps(rig), strict=True):
        np.testing.assert_allclose(found, expected, atol=0.01)


@pytest.mark.parametrize("form", [name for name in writers.FORMATS if not name.startswith("opencv")])
def test_how_a_file_was_understood_is_said(tmp_path: Path, form: str) -> None:
    rig = RIGS[writers.FORMATS[form].rigs[0]]
    assert read_stereo_calibration(writers.FORMATS[form].write(tmp_path, rig), rig.left.size).notes


def test_the_order_of_ros_files_does_not_matter(tmp_path: Path) -> None:
    left, right = writers.ros(None)(tmp_path, RIGS["five"])
    rig = read_stereo_calibration((right, left))
    np.testing.assert_allclose(rig.t_right_left_m, RIGS["five"].t_right_left_m, atol=1e-12)
    assert any("left.yaml is the left camera's" in note for note in rig.notes)
    with pytest.raises(RigError, match=r"left\.yaml is the camera_info of one camera; .* --stereo RIGHT"):
        read_stereo_calibration(left)
    with pytest.raises(RigError, match=r"P\[0,3\] is 0, as the left camera's"):
        read_stereo_calibration((left, left))


@pytest.mark.parametrize("form", ["ros", "kitti raw"])
def test_images_that_the_calibrations_own_rectification_made(tmp_path: Path, form: str) -> None:
    """Its projections are those of the rectified images, so nothing is left to rectify, and depths are true."""
    rig = RIGS["five"]
    flat = already_rectified(read_stereo_calibration(writers.FORMATS[form].write(tmp_path, rig)))
    truth, plane = rectify(rig), rectify(flat)
    assert (plane.left.maps, plane.right.maps) == (None, None)
    assert plane.focal_px == pytest.approx(truth.focal_px)
    assert plane.baseline_m == pytest.approx(truth.baseline_m)


def test_opencvs_projections_count_for_rectified_images(tmp_path: Path) -> None:
    rig = RIGS["five"]
    _, _, left_P, right_P = bouguet(rig)
    entries = {**writers.opencv_entries(rig), "P1": left_P, "P2": right_P}
    read = read_stereo_calibration(writers.write_storage(tmp_path / "stereo.yaml", entries))
    assert not np.isclose(read.left.K[0, 0], left_P[0, 0])
    np.testing.assert_allclose(already_rectified(read).left.K, left_P[:, :3])


def test_the_size_of_the_images_tells_kittis_rectified_ones(tmp_path: Path) -> None:
    rig = RIGS["five"]
    (path,) = writers.kitti_raw(tmp_path, rig)
    size = (rig.left.size[0] - 40, rig.left.size[1] - 30)
    read = read_stereo_calibration(path, size)
    assert read.left.size == size
    assert not read.left.distortion.any()
    assert read.baseline_m == pytest.approx(rig.baseline_m)


@pytest.mark.parametrize(
    ("left", "right"), [("image_00", "image_03"), ("image_02", "image_01"), ("image_03", "image_02")]
)
def test_images_of_cameras_that_are_no_pair_of_kittis_are_named(tmp_path: Path, left: str, right: str) -> None:
    rig = RIGS["five"]
    (path,) = writers.kitti_raw(tmp_path, rig)
    read = read_rig(path, ForImages(rig.left.size, tmp_path / "image_00/data", right=tmp_path / "image_01/data"))
    np.testing.assert_allclose(read.t_right_left_m, rig.t_right_left_m, atol=1e-9)
    with pytest.raises(RigError, match=rf"cameras {int(left[-2:])} and {int(right[-2:])}, .*; needed .* the left one"):
        read_stereo_calibration(path, None, tmp_path / left / "data", right_folder=tmp_path / right / "data")


P0 = np.array([[718.856, 0.0, 607.1928, 0.0], [0.0, 718.856, 185.2157, 0.0], [0.0, 0.0, 1.0, 0.0]])


@pytest.mark.parametrize(("folder", "pair"), [("image_2", (2, 3)), ("image_0", (0, 1)), ("left", (2, 3))])
def test_kittis_projections_and_the_cameras_meant(tmp_path: Path, folder: str, pair: tuple[int, int]) -> None:
    shifts = np.array([[0.0, 0.0, 0.0], [-0.54, 0.0, 0.0], [0.06, -0.001, 0.003], [-0.47, 0.002, 0.003]])
    lines = [
        f"P{i}: " + writers.numbers(P0 + np.pad((P0[:, :3] @ t)[:, None], ((0, 0), (3, 0))))
        for i, t in enumerate(shifts)
    ]
    path = tmp_path / "calib.txt"
    path.write_text("\n".join([*lines, "R0_rect: 1 0 0 0 1 0 0 0 1", "Tr_velo_to_cam: 1 2 3"]))
    rig = read_stereo_calibration(path, (1241, 376), tmp_path / folder / "data")
    np.testing.assert_allclose(rig.t_right_left_m, shifts[pair[1]] - shifts[pair[0]], atol=1e-9)
    np.testing.assert_array_equal(rig.left.K, P0[:, :3])
    assert not rig.left.distortion.any()
    assert any(f"P{pair[0]} and P{pair[1]}" in note for note in rig.notes)
    with pytest.raises(RigError, match="lacks the image size"):
        read_stereo_calibration(path)


MIDDLEBURY = """cam0=[3979.911 0 1244.772; 0 3979.911 1019.507; 0 0 1]
cam1=[3979.911 0 1369.115; 0 3979.911 1019.507; 0 0 1]
doffs=124.343
baseline=193.001
width=2964
height=2000
"""


def test_middleburys_depths_are_those_of_its_formula(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    path.write_text(MIDDLEBURY)
    rig = read_stereo_calibration(path)
    # Z = baseline f / (d + doffs), of a point whose columns in the files' images differ by d.
    Z = 0.193001 * 3979.911 / (100.0 + 124.343)
    point = np.array([0.1, -0.2, Z])
    columns = [(lens.K @ p / p[2])[0] for lens, p in ((rig.left, point), (rig.right, point + rig.t_right_left_m))]
    assert columns[0] - columns[1] == pytest.approx(100.0)
    _, _, left_P, right_P = bouguet(already_rectified(rig))
    assert -right_P[0, 3] / Z == pytest.approx(100.0 + 124.343)
    assert left_P[0, 0] == pytest.approx(3979.911)
    path.write_text(MIDDLEBURY.replace("doffs=124.343", "doffs=12"))
    with pytest.raises(RigError, match=r"doffs is 12, the principal points are 124\.343 pixels apart"):
        read_stereo_calibration(path)


@pytest.mark.parametrize("name", ["K1", "M1", "cameraMatrixL"])
@pytest.mark.parametrize("swapped", [False, True])
def test_of_two_files_that_disagree_a_lens_is_taken_whole(tmp_path: Path, name: str, swapped: bool) -> None:
    """A matrix and a distortion of different calibrations are no lens, whatever names the files have for them."""
    rig = RIGS["five"]
    inner, outer = writers.opencv_two(tmp_path, rig)
    K, distortion = rig.left.K + np.diag([9.0, 9.0, 0.0]), rig.left.distortion * 0.9
    extrinsics = {"R": rig.R_right_left, "T": rig.t_right_left_m, name: K}
    files = (outer, inner) if swapped else (inner, outer)

    writers.write_storage(outer, extrinsics)
    read = read_stereo_calibration(files)
    np.testing.assert_array_equal(read.left.K, rig.left.K)
    np.testing.assert_array_equal(read.left.distortion, rig.left.distortion)
    (note,) = [note for note in read.notes if "in both files, and not the same" in note]
    assert note.endswith(f"taken from {inner}, which has the whole lens")
    assert note.startswith("K1: " if name == "K1" else f"K1, {name}: ")

    writers.write_storage(outer, {**extrinsics, "D1": distortion})
    read = read_stereo_calibration(files)
    np.testing.assert_array_equal(read.left.K, K)
    np.testing.assert_array_equal(read.left.distortion, distortion)
    (note,) = [note for note in read.notes if "in both files, and not the same" in note]
    assert note == f"{'K1' if name == 'K1' else f'K1, {name}'}, D1: in both files, and not the same; taken from {outer}"


@pytest.mark.parametrize(
    ("unit", "metres"), [("millimeters", 1e-3), ("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("inches", 0.0254), ("", 1e-3)]
)
def test_matlabs_units(tmp_path: Path, unit: str, metres: float) -> None:
    struct_ = writers.matlab_struct(RIGS["five"])
    struct_["TranslationOfCamera2"] = RIGS["five"].t_right_left_m / metres
    struct_["CameraParameters1"]["WorldUnits"] = unit
    savemat(tmp_path / "stereo.mat", {"stereoParams": struct_})
    rig = read_stereo_calibration(tmp_path / "stereo.mat")
    np.testing.assert_allclose(rig.t_right_left_m, RIGS["five"].t_right_left_m)


def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


HEADER = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"


def test_matlab_files_that_only_matlab_opens(tmp_path: Path) -> None:
    path = tmp_path / "stereo.mat"
    texts = [element(1, text) for text in (b"stereoParams", b"MCOS", b"stereoParameters")]
    opaque = element(14, element(6, struct.pack("<II", 17, 0)) + b"".join(texts))
    for content, message in (
        (HEADER + opaque, r"MATLAB object, .* needed is a struct, in MATLAB: s = toStruct\(stereoParams\); save"),
        (b"MATLAB 7.3 MAT-file".ljust(512, b"\0"), r"version 7\.3 \(HDF5\); needed is version 7, .*'-v7'"),
        (HEADER + opaque[:40], "damaged MATLAB file"),
        (HEADER + element(14, b""), "is no OpenCV|lacks"),
        (b"MATLAB 5.0", "damaged MATLAB file"),
        (HEADER + element(15, zlib.compress(bytes(LARGEST_UNPACKED + 9)))[:-4], "unpacks to more|ends beyond"),
    ):
        path.write_bytes(content)
        with pytest.raises(RigError, match=message):
            read_stereo_calibration(path)


def altered(form: str, old: str, new: str, name: str | None = None) -> tuple[str, str, str, str]:
    return form, name or writers.FORMATS[form].rigs[0], old, new


@pytest.mark.parametrize(
    ("case", "message"),
    [
        (altered("kalibr", "camera_model: pinhole", "camera_model: omni"), "camera_model is 'omni', .*pinhole-radtan"),
        (
            altered("kalibr", "distortion_model: radtan", "distortion_model: fov"),
            "distortion_model is 'fov'; needed is",
        ),
        (altered("kalibr", "cam1:", "camera1:"), "the camchain has cam0 only; needed are two"),
        (altered("kalibr", "T_cn_cnm1", "T_cam_imu"), "cam1 lacks the transform from the camera before it"),
        (
            altered("basalt", '"pinhole-radtan8"', '"ds"'),
            "camera_type is 'ds', .*needed is pinhole, pinhole-radtan8 or kb4",
        ),
        (altered("basalt", '"qw": ', '"qw": 9'), "the quaternion's length is .*; needed is 1"),
        (altered("depthai", '"toCameraSocket": 2', '"toCameraSocket": 7'), "lead to no camera that both lead to"),
        (altered("depthai", '"cameraType": 0', '"cameraType": 3'), "cameraType is 3; needed is 0"),
        (altered("depthai", "[[0, {", "[[9, 9], [0, {"), "holds something that is no pair of a socket and a camera"),
        (altered("matlab json", '"millimeters"', '"furlongs"'), "WorldUnits is 'furlongs'; needed is"),
        (altered("matlab json", '"RotationOfCamera2"', '"R"'), "lacks RotationOfCamera2 and PoseCamera2"),
        (altered("kitti raw", "K_03", "X_03"), "lacks the K of camera 3; needed is one of K_03"),
        (altered("ros", "plumb_bob", "thin_film"), "distortion_model is 'thin_film'; needed is pinhole or fisheye"),
        (altered("opencv yaml", "image_width: 400", "image_width: 1e400"), "not finite"),
        (altered("opencv yaml", "rows: 3", "rows: 1000000000"), "is no matrix"),
        (altered("ros", "rows: 3", "rows: 1000000000"), "is no matrix"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(
    tmp_path: Path, case: tuple[str, str, str, str], message: str
) -> None:
    form, name, old, new = case
    paths = writers.FORMATS[form].write(tmp_path, RIGS[name])
    for path in paths:
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))
    with pytest.raises(RigError, match=message) as refused:
        read_stereo_calibration(paths)
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize("form", list(writers.FORMATS))
def test_any_damage_is_refused_or_leaves_a_rig(tmp_path: Path, form: str) -> None:
    paths = writers.FORMATS[form].write(tmp_path, RIGS[writers.FORMATS[form].rigs[0]])
    whole = paths[-1].read_bytes()
    words = (
        "P0: ",
        "K_00: ",
        "cam0=[",
        ";",
        "{",
        "[",
        '"',
        ":",
        "\n",
        " ",
        "1e400",
        "nan",
        "-",
        "&a ",
        "*a",
        "!!python/x ",
    )

    @fuzz
    @given(st.one_of(mutations(whole), mutations(whole), noise(*words)))
    def check(content: bytes) -> None:
        paths[-1].write_bytes(content)
        rig = read_or_refused(lambda: read_rig(paths, ForImages((400, 300))), RigError)
        if rig is not None:
            assert 0.02 <= rig.baseline_m <= 10.0
            for lens in (rig.left, rig.right):
                assert np.isfinite(lens.K).all()
                assert np.isfinite(lens.distortion).all()

    check()


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{b}: &{b} [{','.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    "text",
    [
        BOMB,
        "K1: !!python/object/apply:os.system ['false']\n",
        '<!DOCTYPE a [<!ENTITY b "bbbb"><!ENTITY c "&b;&b;&b;">]><opencv_storage>&c;</opencv_storage>',
        '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><opencv_storage><K1>&x;</K1></opencv_storage>',
        "K1: " + "9" * 1_000_000 + "x\n",
        "K1: " + '"\\' * 200_000,
        "K1: [" + "1,\n" * 200_000,
        "P0: " + "1 " * 200_000,
        "cam0=[" + "1;" * 200_000,
        '{"cameraData": ' + "[" * 900 + "]" * 900 + "}",
        '{"value0": {"T_imu_cam": [1], "intrinsics": {}}}',
        '{"cameraData": [[1e400, {}]]}',
        "cam0: [1]\ncam1: {}\n",
    ],
    ids=range(13),
)
def test_hostile_files_are_refused_at_once(tmp_path: Path, text: str) -> None:
    path = tmp_path / "stereo.yaml"
    path.write_text(text)
    with pytest.raises(RigError) as refused:
        read_stereo_calibration(path, (400, 300))
    line = str(refused.value)
    assert len(line.splitlines()) == 1
    assert len(line) < 2000
    assert "root:" not in line


def test_names_as_long_as_they_like_are_said_in_short(tmp_path: Path) -> None:
    (path,) = writers.FORMATS["kalibr"].write(tmp_path, RIGS["four"])
    path.write_text(path.read_text().replace("T_cn_cnm1:", f"T_cn{'_' * 5000}cnm1: [1.0]\n  x:"))
    with pytest.raises(RigError, match=r"T_cn_.*\.\.\. holds 1 numbers") as refused:
        read_stereo_calibration(path, (400, 300))
    assert len(str(refused.value)) < 1000


def test_a_file_larger_than_calibrations_are_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "stereo.yaml"
    with path.open("wb") as stream:
        stream.truncate(LARGEST_FILE + 1)
    with pytest.raises(RigError, match=f"has {LARGEST_FILE + 1} bytes; needed is a stereo calibration"):
        read_stereo_calibration(path)


@pytest.mark.parametrize(
    "names",
    [
        ("stereo.mat",),
        ("left.yaml", "right.yaml"),
        ("intrinsics.yml", "extrinsics.yml"),
        ("camchain.yaml",),
        ("site-camchain.yaml",),
        ("calib.txt",),
        ("calib_cam_to_cam.txt",),
    ],
)
def test_files_that_are_found_beside_the_images(tmp_path: Path, names: tuple[str, ...]) -> None:
    left = tmp_path / "left"
    left.mkdir()
    expected = tuple(tmp_path / name for name in names)
    for path in expected:
        with pytest.raises(RigError, match=r"no stereo\.yaml"):
            calibration_files((), left)
        path.touch()
    assert calibration_files((), left) == expected
    assert calibration_files((tmp_path,), Path("elsewhere/left")) == expected
    assert calibration_files(Path("mine.yaml"), left) == (Path("mine.yaml"),)


def test_files_that_are_not_found(tmp_path: Path) -> None:
    left = tmp_path / "left"
    left.mkdir()
    with pytest.raises(
        RigError,
        match=r"no stereo\.yaml, left\.yaml with right\.yaml.*or SN\*\.conf; needed is one, or --stereo FILE",
    ):
        calibration_files((), left)
    with pytest.raises(RigError, match=r"left is a folder; needed is a file, or a folder with"):
        calibration_files((left,), left)
    for name in ("a-camchain.yaml", "b-camchain.yaml"):
        (tmp_path / name).touch()
    with pytest.raises(RigError, match=r"holds a-camchain\.yaml, b-camchain\.yaml; needed is one of them"):
        calibration_files((), left)
    with pytest.raises(RigError, match="3 files are given"):
        read_stereo_calibration([left, left, left])


def test_images_of_both_cameras_side_by_side_are_named(tmp_path: Path) -> None:
    (path,) = writers.FORMATS["opencv yaml"].write(tmp_path, RIGS["five"])
    width, height = RIGS["five"].left.size
    with pytest.raises(RigError, match=r"\(are both cameras' side by side in each\? cut them in two\)"):
        read_stereo_calibration(path, (2 * width, height))


def test_images_that_were_scaled_are_named(tmp_path: Path) -> None:
    (path,) = writers.FORMATS["opencv yaml"].write(tmp_path, RIGS["five"])
    with pytest.raises(RigError, match=r"were they scaled by 0\.5"):
        read_stereo_calibration(path, (200, 150))


@needs_shared
def test_a_real_camchain() -> None:
    rig = read_stereo_calibration(FAMOUS / "kalibr_camchain.yaml", (720, 540))
    assert rig.baseline_m == pytest.approx(0.32196, abs=1e-5)
    assert rig.left.K[0, 0] == 589.7363083173951
    assert rig.right.distortion[3] == -0.0005160611286370294
    assert rig.t_right_left_m[0] < 0


@needs_shared
def test_real_camera_infos() -> None:
    rig = read_stereo_calibration((FAMOUS / "ros_left.yaml", FAMOUS / "ros_right.yaml"), (640, 480))
    assert rig.baseline_m == pytest.approx(50.49601 / 664.79926)
    assert rig.left.K[0, 0] == 514.58479
    # What the tool rectified by its own R and P, ours rectifies alike but for a turn about the baseline and the zoom.
    left_R, right_R, _, _ = bouguet(rig)
    for R, told in ((left_R, 0.00162611), (right_R, -0.00002211)):
        assert R[0, 1] == pytest.approx(told, abs=1e-4)
    assert already_rectified(rig).left.K[0, 0] == 664.79926


@needs_shared
def test_a_real_middlebury_pair() -> None:
    rig = read_stereo_calibration(FAMOUS / "middlebury_calib.txt", (2964, 2000))
    assert rig.baseline_m == pytest.approx(0.193001)
    assert rig.right.K[0, 2] - rig.left.K[0, 2] == pytest.approx(124.343)


@needs_shared
def test_real_files_that_hold_no_whole_rig() -> None:
    with pytest.raises(RigError, match=r"has camera 0; needed are 0 and 1, or 2 and 3: of raw .* S, K, D"):
        read_stereo_calibration(FAMOUS / "kitti_calib_cam_to_cam.txt", (1242, 375))
    with pytest.raises(RigError, match=r"opencv_intrinsics\.yml lacks the rotation between the cameras"):
        read_stereo_calibration(FAMOUS / "opencv_intrinsics.yml", (640, 480))
    with pytest.raises(RigError, match=r"thaytan_extrinsics\.yml lacks the pinhole distortion of the left camera"):
        read_stereo_calibration(FAMOUS / "thaytan_extrinsics.yml", (640, 480))


@needs_shared
def test_a_real_pair_of_files_in_an_unknown_unit() -> None:
    both = (FAMOUS / "opencv_intrinsics.yml", FAMOUS / "thaytan_extrinsics.yml")
    with pytest.raises(
        RigError, match=r"\(length of T\) is 59\.8373 m; .* --baseline M .* \(0\.0598373 if T is in mill"
    ):
        read_stereo_calibration(both, (640, 480))
    rig = read_stereo_calibration(both, (640, 480), baseline_m=0.06)
    assert rig.baseline_m == pytest.approx(0.06)
    assert rig.left.K[0, 0] == rig.right.K[0, 0] == 534.80326845051309  # the extrinsics' own K1 has no distortion
    assert rig.left.distortion[0] == 0.29589439552724328


# ZED

HD = (1280, 720)
ZEDS = {
    "five": rigs.rig(
        rigs.lens(rigs.FIVE, size=HD), rigs.lens(rigs.FIVE, shift=(30.0, -20.0), size=HD), (0.2, -0.3, 0.1)
    ),
    "eight": rigs.rig(rigs.lens(rigs.EIGHT, size=HD), rigs.lens(rigs.EIGHT, size=HD), (-0.1, 0.2, 0.3)),
    "fisheye": rigs.rig(*[rigs.lens(rigs.FISHEYE, "fisheye", size=HD)] * 2, (0.1, 0.2, -0.3)),
}


@pytest.mark.parametrize("name", ZEDS)
def test_the_size_of_the_images_chooses_the_sections_of_a_zed(tmp_path: Path, name: str) -> None:
    rig = ZEDS[name]
    read = read_stereo_calibration(writers.zed(tmp_path, rig), HD)
    assert read.left.model == rig.left.model
    np.testing.assert_allclose(read.t_right_left_m, rig.t_right_left_m, atol=1e-9)
    for found, expected in zip(maps(read), maps(rig), strict=True):
        np.testing.assert_allclose(found, expected, atol=0.01)
    assert "ZED: the sections of HD, for raw (unrectified) images of 1280 x 720 pixels" in read.notes
    assert calibration_files((), tmp_path / "left") == (tmp_path / "SN1.conf",)


def test_a_zeds_file_that_cannot_be_right_is_refused(tmp_path: Path) -> None:
    path = writers.zed(tmp_path, ZEDS["five"])
    for size, said in (
        ((2560, 720), r"2560 x 720 pixels \(are both cameras' side by side in each\? cut them in two\); needed"),
        ((640, 480), r"640 x 480 pixels; needed are 2208 x 1242, .*, 672 x 376"),
        ((672, 376), r"LEFT_CAM_VGA is needed, the file lacks it; it holds .*LEFT_CAM_HD"),
        (None, r"of a ZED, in several resolutions; needed are the images that it is for"),
    ):
        with pytest.raises(RigError, match=said):
            read_stereo_calibration(path, size)
    text = path.read_text()
    for old, new, said in (
        ("CV_HD", "CV_VGA", "lacks the CV"),
        ("[LEFT_CAM_HD]", "x\n[LEFT_CAM_HD]", "cannot be read: .* needed is a ZED's"),
        ("Baseline=", "Baseline=a", "baseline is no matrix"),
    ):
        path.write_text(text.replace(old, new))
        with pytest.raises(RigError, match=said):
            read_stereo_calibration(path, HD)
    path.write_text("\n".join(line for line in text.splitlines() if not line.startswith(("TY", "TZ"))))
    assert "TY, which the file lacks, taken as 0" in read_stereo_calibration(path, HD).notes


@fuzz
@given(st.data())
def test_a_damaged_file_of_a_zed_is_read_or_refused(tmp_path: Path, data: st.DataObject) -> None:
    whole = writers.zed(tmp_path, ZEDS["eight"]).read_bytes()
    (tmp_path / "SN2.conf").write_bytes(data.draw(mutations(whole)))
    read_or_refused(lambda: read_stereo_calibration(tmp_path / "SN2.conf", HD), RigError)
