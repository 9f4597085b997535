"""A result is read again, or refused in one line, whatever its numbers are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from laci_stereo.core.errors import CalibrationFileError
from laci_stereo.io.result.calibration_file import to_text
from laci_stereo.io.result.exports import export_as
from laci_stereo.io.result.imported import ImportOptions, import_pose, imported_document
from laci_stereo.io.result.stored_calibration import read_calibration
from tests.io.sitings import siting

BEYOND_FLOATS = 10**400


def document(folder: Path) -> dict[str, Any]:
    pose = folder / "pose.yaml"
    pose.write_text(export_as(siting("stereo"), "opencv")[0].text)
    return imported_document(import_pose(pose, ImportOptions()), {}, {})


@pytest.mark.parametrize(
    "change",
    [
        lambda made: made.update(covariance=[[BEYOND_FLOATS] * 6] * 6),
        lambda made: made["T_world_sensor"][0].__setitem__(0, BEYOND_FLOATS),
        lambda made: made["world"].update(origin_utm=[BEYOND_FLOATS, 0.0]),
        lambda made: made.update(background_boxes=[[BEYOND_FLOATS] * 6]),
    ],
    ids=["covariance", "transform", "origin", "boxes"],
)
def test_whole_numbers_beyond_floats_are_refused(change: Any, tmp_path: Path) -> None:
    made = document(tmp_path)
    change(made)
    path = tmp_path / "calibration.json"
    path.write_text(to_text(made))
    with pytest.raises(CalibrationFileError) as caught:
        read_calibration(path)
    assert len(str(caught.value).splitlines()) == 1
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda made: made.update(covariance=np.full((6, 6), np.inf).tolist()), "covariance has the eigenvalue nan"),
        (lambda made: made["T_world_sensor"][0].__setitem__(3, float("nan")), "not finite"),
        (lambda made: made["T_world_sensor"][0].__setitem__(0, 1e200), "is no rigid transform"),
        (lambda made: made.update(background_boxes=[[float("-inf")] * 6]), "not finite"),
        (
            lambda made: made["T_utm_sensor"][0].__setitem__(3, made["T_utm_sensor"][0][3] + 1.0),
            "contradict .* up to 1: ",
        ),
        (lambda made: made["world"].update(grid_scale=1.01), "T_utm_sensor and T_world_sensor contradict each other"),
        (lambda made: made["sensor"].update(kind="k" * 5000), "kkk.*"),
        (lambda made: made.update(covariance=[[0.5] * 6] * 2000), "covariance: "),
        (lambda made: made["world"].update(crs="EPSG:4326"), "'EPSG:4326' is WGS 84; needed is a UTM zone"),
        (lambda made: made["world"].update(crs="EPSG:32699"), "'EPSG:32699' is not known to PROJ"),
    ],
)
def test_numbers_beyond_measure_and_long_mistakes_are_one_line(change: Any, message: str, tmp_path: Path) -> None:
    made = document(tmp_path)
    change(made)
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(made))
    with pytest.raises(CalibrationFileError, match=message) as caught:
        read_calibration(path)
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 1000


def with_covariance(made: dict[str, Any], *changes: tuple[int, int, float]) -> None:
    covariance = np.diag([1e-6, 1e-6, 1e-5, 0.01, 0.01, 1e-4])
    covariance[2, 3] = covariance[3, 2] = 1e-4
    for row, column, value in changes:
        covariance[row, column] = value
    made.update(covariance=covariance.tolist())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ([(i, j, 0.0) for i in range(6) for j in range(6)], "covariance has the variance 0, .* or null"),
        ([(5, 5, 0.0)], "covariance has the variance 0, "),
        ([(2, 3, 1.0), (3, 2, 1.0)], "covariance has the eigenvalue -"),
        ([(0, 1, 5e-7)], "not symmetric, it has 5e-07 in row 1, column 2 and 0 the other way"),
    ],
    ids=["zeros", "one zero", "more than certain", "askew"],
)
def test_what_is_no_covariance_is_refused(changes: list[tuple[int, int, float]], message: str, tmp_path: Path) -> None:
    made = document(tmp_path)
    with_covariance(made)
    (tmp_path / "calibration.json").write_text(to_text(made))
    assert read_calibration(tmp_path).claims
    with_covariance(made, *changes)
    (tmp_path / "calibration.json").write_text(to_text(made))
    with pytest.raises(CalibrationFileError, match=message) as caught:
        read_calibration(tmp_path)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("result", ["none", "", "calibration.json"])
def test_where_there_is_none_it_says_what_is_needed(result: str, tmp_path: Path) -> None:
    with pytest.raises(CalibrationFileError, match=r"does not exist; needed is a result's folder or its calibration"):
        read_calibration(tmp_path / result)


@pytest.mark.parametrize(("told", "read"), [(1, 1.0), (0.6, 0.6), (None, None)])
def test_a_baseline_may_be_a_whole_number(told: float | None, read: float | None, tmp_path: Path) -> None:
    made = document(tmp_path)
    made["config"]["stereo"] = {"baseline_m": told}
    (tmp_path / "calibration.json").write_text(to_text(made))
    assert read_calibration(tmp_path).baseline_m == read


def test_a_sound_one_is_read(tmp_path: Path) -> None:
    (tmp_path / "calibration.json").write_text(to_text(document(tmp_path)))
    np.testing.assert_allclose(read_calibration(tmp_path).T_utm_sensor, siting("stereo").T_utm_sensor, atol=1e-8)


@pytest.mark.parametrize(
    ("text", "what"), [("1 0 0 5", "is no JSON"), ('{"T": 1}', "is no result"), ("[]", "is no result")]
)
def test_what_other_tools_wrote_is_to_be_imported(text: str, what: str, tmp_path: Path) -> None:
    (tmp_path / "pose.txt").write_text(text)
    with pytest.raises(CalibrationFileError, match=rf"{what}.*\(laci-stereo import makes one of what other tools"):
        read_calibration(tmp_path / "pose.txt")
