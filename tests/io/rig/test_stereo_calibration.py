from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from laci_stereo.core.errors import RigError
from laci_stereo.io.rig.stereo_calibration import calibration_files, read_stereo_calibration
from laci_stereo.io.rig.stereo_rig import StereoRig
from tests.io.support import SHARED, fuzz, mutations, needs_shared, noise, read_or_refused

SIZE = (1280, 720)
K_LEFT = np.array([[1100.25, 0.0, 639.5], [0.0, 1099.75, 359.5], [0.0, 0.0, 1.0]])
K_RIGHT = np.array([[1101.0, 0.0, 641.0], [0.0, 1102.0, 357.0], [0.0, 0.0, 1.0]])
D_LEFT = np.array([-0.21, 0.08, 1e-4, -2e-4, 0.013])
D_RIGHT = np.array([-0.22, 0.09, 2e-4, -3e-4, 0.014])
R = Rotation.from_euler("xyz", [0.4, -1.1, 0.7], degrees=True).as_matrix()
T = np.array([-0.6, 0.004, 0.002])
ENTRIES = {"K1": K_LEFT, "D1": D_LEFT, "K2": K_RIGHT, "D2": D_RIGHT, "R": R, "T": T}


def write(path: Path, entries: dict[str, object]) -> Path:
    """Write a calibration with OpenCV's own writer."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in entries.items():
        if isinstance(value, tuple):
            storage.startWriteStruct(name, cv2.FILE_NODE_SEQ | cv2.FILE_NODE_FLOW)
            for item in value:
                storage.write("", item)
            storage.endWriteStruct()
        else:
            storage.write(name, value)
    storage.release()
    return path


def sized(**changes: object) -> dict[str, object]:
    entries = {"image_width": SIZE[0], "image_height": SIZE[1], **ENTRIES, **changes}
    return {name: value for name, value in entries.items() if value is not None}


def assert_is_the_rig(rig: StereoRig) -> None:
    for lens, K, distortion in ((rig.left, K_LEFT, D_LEFT), (rig.right, K_RIGHT, D_RIGHT)):
        np.testing.assert_array_equal(lens.K, K)
        np.testing.assert_array_equal(lens.distortion, distortion)
        assert (lens.size, lens.model) == (SIZE, "pinhole")
    np.testing.assert_array_equal(rig.R_right_left, R)
    np.testing.assert_array_equal(rig.t_right_left_m, T)


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.25, 1.5, 2.5])
def test_calibration_of_another_resolution_is_refused_without_an_image_size(tmp_path: Path, factor: float) -> None:
    to_scale = np.diag([factor, factor, 1.0])
    entries = {**ENTRIES, "K1": to_scale @ K_LEFT, "K2": to_scale @ K_RIGHT}
    width, height = round(factor * SIZE[0]), round(factor * SIZE[1])
    with pytest.raises(RigError, match="is it of another resolution, about ") as refused:
        read_stereo_calibration(write(tmp_path / "stereo.yaml", entries), SIZE)
    about = [int(number) for number in re.findall(r"about (\d+) x (\d+)", str(refused.value))[0]]
    assert about == pytest.approx([width, height], rel=0.02)
    assert f"at {50 * factor:.0f} % of the width and height of the 1280 x 720 images" in str(refused.value)
    read_stereo_calibration(write(tmp_path / "right.yaml", entries), (width, height))


@pytest.mark.parametrize(("cx", "cy"), [(900.0, 359.5), (900.0, 250.0), (690.0, 390.0)])
def test_principal_point_off_the_middle_is_no_other_resolution(tmp_path: Path, cx: float, cy: float) -> None:
    """Off along one axis, both ways, or a little."""
    entries = {**ENTRIES, **{f"K{side}": np.array([[1100, 0, cx], [0, 1100, cy], [0, 0, 1]]) for side in (1, 2)}}
    read_stereo_calibration(write(tmp_path / "stereo.yaml", entries), SIZE)
    cropped = {"image_width": SIZE[0], "image_height": SIZE[1], **ENTRIES}
    cropped["K1"] = cropped["K2"] = np.array([[1100.0, 0, 960], [0, 1100, 540], [0, 0, 1]])
    read_stereo_calibration(write(tmp_path / "cropped.yaml", cropped), SIZE)


@pytest.mark.parametrize("suffix", ["yaml", "yml", "json", "xml"])
def test_every_number_comes_back_exactly(tmp_path: Path, suffix: str) -> None:
    rig = read_stereo_calibration(write(tmp_path / f"stereo.{suffix}", sized()))
    assert_is_the_rig(rig)
    assert rig.baseline_m == pytest.approx(np.linalg.norm(T))


@pytest.mark.parametrize(
    "names",
    [
        ("M1", "D1", "M2", "D2", "R", "T"),
        ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2", "R", "T"),
        ("cameraMatrixL", "distCoeffsL", "cameraMatrixR", "distCoeffsR", "R", "T"),
        (
            "camera_matrix_left",
            "dist_coeffs_left",
            "camera_matrix_right",
            "dist_coeffs_right",
            "rotation",
            "translation",
        ),
        (
            "left_camera_matrix",
            "left_distortion_coefficients",
            "right_camera_matrix",
            "right_distortion_coefficients",
            "R",
            "T",
        ),
        ("left_K", "left_D", "right_K", "right_D", "rotation_matrix", "translation_vector"),
        ("camera_matrix_1", "dist_coeff_1", "CAMERA_MATRIX_2", "dist_coeff_2", "r", "t"),
    ],
)
def test_the_names_that_tools_give(tmp_path: Path, names: tuple[str, ...]) -> None:
    renamed = dict(zip(names, ENTRIES.values(), strict=True))
    assert_is_the_rig(read_stereo_calibration(write(tmp_path / "stereo.yaml", renamed), SIZE))


@pytest.mark.parametrize(
    "size", [{"image_size": SIZE}, {"size": SIZE}, {"imageSize": SIZE}, {"imageSize": np.array([SIZE])}]
)
def test_the_image_size_in_its_ways(tmp_path: Path, size: dict[str, object]) -> None:
    assert_is_the_rig(read_stereo_calibration(write(tmp_path / "stereo.yaml", {**size, **ENTRIES})))


def test_without_an_image_size_the_images_tell_it(tmp_path: Path) -> None:
    path = write(tmp_path / "stereo.yaml", ENTRIES)
    assert read_stereo_calibration(path, SIZE).right.size == SIZE
    with pytest.raises(RigError, match=r"stereo\.yaml lacks the image size; needed are image_width and image_height"):
        read_stereo_calibration(path)


@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
@pytest.mark.parametrize("shape", [(-1,), (1, -1), (-1, 1)])
def test_pinhole_distortion_of_every_length(tmp_path: Path, count: int, shape: tuple[int, ...]) -> None:
    distortion = np.linspace(0.01, 0.02, count)
    rig = read_stereo_calibration(write(tmp_path / "s.yaml", sized(D1=distortion.reshape(shape))))
    np.testing.assert_array_equal(rig.left.distortion, distortion)


@pytest.mark.parametrize(
    "entry", [{"model": "fisheye"}, {"distortion_model": "equidistant"}, {"camera_model": "Fisheye"}]
)
def test_fisheye_is_named_and_has_four_coefficients(tmp_path: Path, entry: dict[str, object]) -> None:
    rig = read_stereo_calibration(write(tmp_path / "s.yaml", sized(D1=D_LEFT[:4], D2=D_RIGHT[:4], **entry)))
    assert (rig.left.model, rig.right.model) == ("fisheye", "fisheye")
    with pytest.raises(RigError, match=r"D1 holds 5.* numbers; needed are 4 numbers"):
        read_stereo_calibration(write(tmp_path / "s.yaml", sized(**entry)))


def test_a_right_camera_on_the_left_is_no_error_here(tmp_path: Path) -> None:
    assert read_stereo_calibration(write(tmp_path / "s.yaml", sized(T=-T))).baseline_m > 0


@pytest.mark.parametrize("per_metre", [1.0, 100.0, 1000.0, 1 / 0.0254, 1 / 0.0317])
def test_lengths_in_any_unit_are_metres_by_the_baseline(tmp_path: Path, per_metre: float) -> None:
    """Centimetres, millimetres, inches, or squares of a chessboard that nobody has measured."""
    path = write(tmp_path / "s.yaml", sized(T=T * per_metre))
    rig = read_stereo_calibration(path, baseline_m=float(np.linalg.norm(T)))
    np.testing.assert_allclose(rig.t_right_left_m, T, rtol=0, atol=1e-12)
    assert any("as --baseline says" in note for note in rig.notes)


def test_the_baseline_counts_for_rectified_images_as_well(tmp_path: Path) -> None:
    P = np.column_stack([K_LEFT, np.zeros(3)])
    shifted = P + np.outer(K_LEFT @ [-600.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])
    path = write(tmp_path / "s.yaml", sized(T=T * 1000.0, P1=P, P2=shifted))
    flat = read_stereo_calibration(path, baseline_m=float(np.linalg.norm(T))).rectified
    assert flat is not None
    assert flat.baseline_m == pytest.approx(0.6, abs=1e-12)
    assert any("as --baseline says" in note for note in flat.notes)


@pytest.mark.parametrize("baseline_m", [0.0, -0.6, np.nan, np.inf])
def test_a_baseline_that_is_no_length_is_refused(tmp_path: Path, baseline_m: float) -> None:
    with pytest.raises(RigError, match="needed are numbers above 0"):
        read_stereo_calibration(write(tmp_path / "s.yaml", sized()), baseline_m=baseline_m)


def test_cameras_in_one_place_have_no_direction_to_scale(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"the length of T is 0, --baseline says 0\.6 m; needed are numbers above 0"):
        read_stereo_calibration(write(tmp_path / "s.yaml", sized(T=np.zeros(3))), baseline_m=0.6)


def test_a_rotation_vector_is_a_rotation(tmp_path: Path) -> None:
    vector = Rotation.from_matrix(R).as_rotvec()
    rig = read_stereo_calibration(write(tmp_path / "s.yaml", sized(R=vector)))
    np.testing.assert_allclose(rig.R_right_left, R, atol=1e-12)


K_ZERO = K_LEFT * [[0.0, 1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0]]
K_OFF = K_LEFT * [[1.0, 1.0, 4.0], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0]]
K_NAN = K_LEFT * [[np.nan, 1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0]]
# A rig whose cameras are both rolled by 90 deg: what was side by side stands one above the other.
ROLLED = np.array([0.0, -0.6, 0.0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"K2": None}, "lacks the camera matrix of the right camera; needed is one of K2, .* it holds image_width"),
        ({"D1": None}, "lacks the pinhole distortion of the left camera"),
        ({"R": None}, "lacks the rotation between the cameras; needed is one of R, "),
        ({"T": None}, "lacks the translation between the cameras"),
        ({"K1": np.eye(2)}, "K1 holds 2x2 numbers; needed are 3x3"),
        ({"K1": "yes"}, "K1 is no matrix; needed are 3x3 numbers"),
        ({"T": np.eye(3)}, "T holds 3x3 numbers; needed are 3 numbers"),
        ({"D1": D_LEFT[:3]}, "D1 holds 3.* numbers; needed are 4 or 5 or 8 or 12 or 14 numbers"),
        ({"K1": K_ZERO}, "the left camera's focal length is 0, 1099.75 pixels; needed are positive"),
        ({"K1": np.eye(3)[::-1].copy()}, "focal length is 0"),
        ({"K2": K_RIGHT * 2}, "the right camera's camera matrix is no"),
        (
            {"K1": K_OFF},
            "the left camera's principal point is 2558, 359.5; needed is one inside the image of 1280 x 720",
        ),
        ({"R": np.diag([1.0, 1.0, -1.0])}, "R is no rotation .*det R is -1"),
        ({"R": R * 1.01}, "R is no rotation"),
        ({"T": np.zeros(3)}, "the baseline .* is 0 m; .* needed is T in metres, or --baseline M with .* the cameras$"),
        ({"T": T * 1000}, r"is 600\.017 m; .* \(0\.600017 if T is in millimetres, 6\.00017 if T is in centimetres\)"),
        ({"T": T * 100}, r"is 60\.0017 m; .* \(0\.0600017 if T is in millimetres, 0\.600017 if T is in centimetres\)"),
        ({"T": T * 10000}, r"is 6000\.17 m; .* \(6\.00017 if T is in millimetres\)"),
        ({"R": np.eye(3), "T": ROLLED}, "one above the other .* disparity is searched along rows"),
        ({"R": np.eye(3), "T": np.array([0.0, 0.0, 0.6])}, "one behind the other"),
        ({"model": "omnidirectional"}, "model is 'omnidirectional'; needed is pinhole or fisheye"),
        ({"image_width": 0}, "image size is 0 x 720; needed are positive whole numbers"),
        ({"image_height": None}, "lacks the image height"),
    ],
)
def test_what_describes_no_stereo_camera(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    path = write(tmp_path / "stereo.yaml", sized(**changes))
    with pytest.raises(RigError, match=rf"stereo\.yaml.*{message}") as refused:
        read_stereo_calibration(path)
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize(("name", "value"), [("K1", K_NAN), ("T", T * np.inf), ("R", R * np.nan)])
def test_numbers_are_finite(tmp_path: Path, name: str, value: np.ndarray) -> None:
    for suffix in ("yaml", "xml"):
        with pytest.raises(RigError, match=f"{name} holds a number that is not finite"):
            read_stereo_calibration(write(tmp_path / f"s.{suffix}", sized(**{name: value})))


def test_a_calibration_of_another_size_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"s\.yaml: the image size is 1280 x 720; the images are 640 x 360"):
        read_stereo_calibration(write(tmp_path / "s.yaml", sized()), (640, 360))


def test_what_is_no_calibration_file(tmp_path: Path) -> None:
    path = tmp_path / "stereo.yaml"
    for content, message in (
        (None, "does not exist"),
        (b"", "is empty"),
        (bytes(range(256)), "is not a text file"),
        (b"%YAML:1.0\nK1: \0\0\0", "is not a text file"),
        (b"hello", "is no OpenCV FileStorage file"),
    ):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(RigError, match=rf"stereo\.yaml {message}"):
            read_stereo_calibration(path)
    with pytest.raises(RigError, match="is a folder; needed is a stereo calibration"):
        read_stereo_calibration(tmp_path)


def test_the_file_beside_the_left_images_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = tmp_path / "left"
    left.mkdir()
    with pytest.raises(RigError, match=r"no stereo\.yaml"):
        calibration_files((), left)
    for name in ("stereo.xml", "stereo.json", "stereo.yml", "stereo.yaml"):
        (tmp_path / name).touch()
        assert calibration_files((), left) == (tmp_path / name,)
    monkeypatch.chdir(left)
    assert calibration_files((), Path()) == (tmp_path / "stereo.yaml",)


@pytest.mark.parametrize("suffix", ["yaml", "json", "xml"])
def test_any_file_is_read_or_refused(tmp_path: Path, suffix: str) -> None:
    whole = write(tmp_path / f"stereo.{suffix}", sized()).read_bytes()

    @fuzz
    @given(st.one_of(mutations(whole), noise("K1: ", "[", "]", "1", ",", "\n", "- ", '"', "{", "rows: 3", "<a>")))
    def check(content: bytes) -> None:
        path = tmp_path / f"x.{suffix}"
        path.write_bytes(content)
        rig = read_or_refused(lambda: read_stereo_calibration(path), RigError)
        assert rig is None or rig.left.K.shape == (3, 3)

    check()


@needs_shared
def test_the_shared_calibrations() -> None:
    (path,) = calibration_files((), SHARED / "data/crossing/left")
    rig = read_stereo_calibration(path, SIZE)
    assert (rig.left.K[0, 0], rig.baseline_m, rig.left.size) == (1100.0, 0.6, SIZE)
    with pytest.raises(RigError, match=r"lacks the rotation between the cameras.*it holds M1, D1, M2, D2"):
        read_stereo_calibration(SHARED / "formats/stereo/opencv_intrinsics.yml", (640, 480))
