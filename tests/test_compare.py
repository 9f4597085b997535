"""Two results are as far apart as they were put, and agree as often as they claim."""

from __future__ import annotations

import csv
import json
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from laci_stereo.commands.cli import cli
from laci_stereo.compare import compare, compare_two
from laci_stereo.core.errors import CalibrationFileError
from laci_stereo.core.frames import FloatArray, invert, planar, rigid, transform
from laci_stereo.core.result import viewing_angles
from laci_stereo.core.world import World
from laci_stereo.io.result.calibration_file import to_document
from laci_stereo.io.result.stored_calibration import StoredCalibration, read_calibration
from tests.io.support import with_utm
from tests.passages import recorded, save
from tests.report.page_support import PROVENANCE
from tests.report.support import calibration


@cache
def original() -> dict[str, Any]:
    return to_document(calibration(), PROVENANCE)


def moved(six: FloatArray, document: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return a result with an error of (rotation vector, translation) about its centre."""
    changed = deepcopy(document or original())
    about = rigid(np.eye(3), np.array(changed["covariance_centre_world"]))
    turned = rigid(Rotation.from_rotvec(six[:3]).as_matrix(), six[3:])
    T = about @ turned @ invert(about) @ np.array(changed["T_world_sensor"])
    angles = viewing_angles(T, calibration().axes)
    changed["T_world_sensor"] = T.tolist()
    changed["euler_deg"] = {"yaw": angles.yaw_deg, "down": angles.down_deg, "roll": angles.roll_deg}
    return with_utm(changed)


def in_other_world(document: dict[str, Any], east_m: float, north_m: float) -> dict[str, Any]:
    """Return the same result in a world with another origin."""
    changed, k = deepcopy(document), document["world"]["grid_scale"]
    east, north = document["world"]["origin_utm"]
    changed["world"]["origin_utm"] = [east + k * east_m, north + k * north_m]
    shift = np.array([east_m, north_m, 0.0])
    T = np.array(changed["T_world_sensor"])
    T[:3, 3] -= shift
    changed["T_world_sensor"] = T.tolist()
    changed["covariance_centre_world"] = (np.array(changed["covariance_centre_world"]) - shift).tolist()
    return with_utm(changed)


def in_other_zone(document: dict[str, Any], crs: str) -> dict[str, Any]:
    """Return the same result in another UTM zone, by where the axes at its centre lie on the ellipsoid."""
    changed, world = deepcopy(document), document["world"]
    old = World(world["crs"], tuple(world["origin_utm"]), world["grid_scale"])
    centre = np.array(document["covariance_centre_world"])
    axes = centre[:2] + np.array([[0.0, 0.0], [10.0, 0.0], [-10.0, 0.0], [0.0, 10.0], [0.0, -10.0]])
    degrees = old.to_geodetic(axes)
    new = World.around(*degrees[0], crs)
    moved = new.from_geodetic(*degrees.T)
    yaw = np.arctan2(*(moved[1] - moved[2])[::-1])
    assert np.linalg.norm(moved[3] - moved[4]) == pytest.approx(20.0, abs=1e-3)
    T = planar(yaw, moved[0]) @ rigid(np.eye(3), -np.append(centre[:2], 0.0))
    both = np.kron(np.eye(2), T[:3, :3])
    changed["world"] = {"crs": new.crs, "origin_utm": list(new.origin_utm), "grid_scale": new.grid_scale}
    changed["T_world_sensor"] = (T @ np.array(changed["T_world_sensor"])).tolist()
    changed["covariance"] = (both @ np.array(changed["covariance"]) @ both.T).tolist()
    changed["covariance_centre_world"] = [*moved[0], centre[2]]
    changed["euler_deg"]["yaw"] += np.degrees(yaw)
    return with_utm(changed)


def written(folder: Path, name: str, document: dict[str, Any]) -> Path:
    path = folder / f"{name}.json"
    path.write_text(json.dumps(document))
    return path


def stored(folder: Path, document: dict[str, Any]) -> StoredCalibration:
    return read_calibration(written(folder, "stored", document))


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, ["compare", *map(str, arguments)])


def test_result_agrees_with_itself(tmp_path: Path) -> None:
    one = written(tmp_path, "one", original())
    (comparison,) = compare([one, one])
    assert [each.value for each in comparison.differences] == pytest.approx([0.0] * 8, abs=1e-6)
    assert comparison.outcome == "agree"
    assert comparison.probability == pytest.approx(1.0)


def test_differences_are_what_was_put_between(tmp_path: Path) -> None:
    six = np.array([0.0, 0.0, np.radians(0.3), 0.12, -0.05, 0.02])
    first, second = original(), moved(six)
    (comparison,) = compare([written(tmp_path, "a", first), written(tmp_path, "b", second)])
    roll, down, yaw, x, y, z, objects, rotation = (each.value for each in comparison.differences)
    assert (roll, down) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert (yaw, rotation) == pytest.approx((0.3, 0.3), abs=1e-9)
    sensors = [np.array(document["T_world_sensor"])[:3, 3] for document in (first, second)]
    assert (x, y, z) == pytest.approx(tuple(np.abs(sensors[1] - sensors[0])), abs=1e-9)
    assert objects == pytest.approx(np.hypot(0.12, 0.05), abs=1e-9)


def test_angles_are_those_of_the_files(tmp_path: Path) -> None:
    first, second = original(), moved(np.array([0.004, -0.003, 0.002, 0.0, 0.0, 0.0]))
    (comparison,) = compare([written(tmp_path, "a", first), written(tmp_path, "b", second)])
    for each, name in zip(comparison.differences, ("roll", "down", "yaw"), strict=False):
        assert each.value == pytest.approx(abs(second["euler_deg"][name] - first["euler_deg"][name]))


def test_world_in_which_a_result_is_given_does_not_matter(tmp_path: Path) -> None:
    second = moved(np.array([1e-3, 0.0, 2e-3, 0.1, 0.05, 0.01]))
    plain = compare([written(tmp_path, "a", original()), written(tmp_path, "b", second)])[0]
    elsewhere = compare([written(tmp_path, "a", original()), written(tmp_path, "c", in_other_world(second, 40, -25))])[
        0
    ]
    assert elsewhere.chi_square == pytest.approx(plain.chi_square, rel=1e-6)
    for one, other in zip(plain.differences, elsewhere.differences, strict=True):
        assert (other.value, other.sigma) == pytest.approx((one.value, one.sigma), rel=1e-5, abs=1e-7)


@pytest.mark.parametrize("crs", ["EPSG:32631", "EPSG:32633"])
def test_zone_in_which_a_result_is_given_does_not_matter(tmp_path: Path, crs: str) -> None:
    second = moved(np.array([1e-3, 0.0, 2e-3, 0.1, 0.05, 0.01]))
    other = in_other_zone(second, crs)
    assert abs(other["euler_deg"]["yaw"] - second["euler_deg"]["yaw"]) > 1.0
    plain = compare([written(tmp_path, "a", original()), written(tmp_path, "b", second)])[0]
    zone = compare([written(tmp_path, "a", original()), written(tmp_path, "c", other)])[0]
    assert zone.chi_square == pytest.approx(plain.chi_square, rel=1e-3)
    for one, two in zip(plain.differences, zone.differences, strict=True):
        assert (two.value, two.sigma) == pytest.approx((one.value, one.sigma), rel=1e-3, abs=1e-5)


@pytest.mark.slow
def test_chi_square_is_that_of_six_where_both_are_as_good_as_they_claim(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    covariance = np.array(original()["covariance"])
    found = []
    for _ in range(150):
        one, other = (stored(tmp_path, moved(rng.multivariate_normal(np.zeros(6), covariance))) for _ in range(2))
        track = one.centre_world[None, :2]
        found.append(compare_two(one, other, track, track).chi_square)
    assert np.mean(found) == pytest.approx(6.0, abs=5 * np.sqrt(12.0 / 150))
    assert np.mean(np.array(found) > chi2.isf(0.01, 6)) < 0.05


@pytest.mark.slow
def test_every_sigma_is_the_scatter_of_its_difference(tmp_path: Path) -> None:
    """Objects away from the centre, and the sensor itself, are moved by turns too, and their sigmas know."""
    rng = np.random.default_rng(8)
    covariance = np.array(original()["covariance"])
    base = stored(tmp_path, original())
    track = base.centre_world[None, :2] + np.array([[0.0, 15.0], [20.0, 0.0]])
    apart, sigmas = [], np.zeros(8)
    for _ in range(300):
        other = stored(tmp_path, moved(rng.multivariate_normal(np.zeros(6), 2 * covariance)))
        differences = compare_two(base, other, track, track).differences
        apart.append([each.value for each in differences])
        sigmas = np.array([each.sigma for each in differences])
    assert np.sqrt(np.mean(np.square(apart), axis=0)) / sigmas == pytest.approx(np.ones(8), abs=0.13)


def test_far_result_contradicts(tmp_path: Path) -> None:
    sigma_z = np.sqrt(np.array(original()["covariance"])[5, 5])
    far = moved(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 8 * np.sqrt(2) * sigma_z]))
    paths = written(tmp_path, "a", original()), written(tmp_path, "b", far)
    assert compare(paths)[0].outcome == "contradict"
    ended = run(*paths)
    assert ended.exit_code == 1
    assert "CONTRADICT" in ended.output
    assert "so far apart in less than 0.0001 % of cases" in ended.output


def test_several_results_are_summed_up_and_the_odd_one_is_seen(tmp_path: Path) -> None:
    sigma_z = np.sqrt(np.array(original()["covariance"])[5, 5])
    far = moved(np.array([0.0, 0.0, 0.0, 0.3, 0.0, 8 * np.sqrt(2) * sigma_z]))
    paths = [written(tmp_path, name, each) for name, each in (("a", original()), ("b", far), ("c", original()))]
    output = run(*paths).output
    assert "3 results, 3 pairs: 1 agree, 2 contradict each other" in output
    lines = {line.split()[0]: line.split()[1:] for line in output[output.index("3 results") :].splitlines()[2:5]}
    assert lines[str(paths[0])] == ["1", "of", "2", "0.150", "m", "0.300", "m"]
    assert lines[str(paths[1])] == ["2", "of", "2", "0.300", "m", "0.300", "m"]
    assert "pairs" not in run(*paths[:2]).output


def test_shares_are_percentages_that_people_read(tmp_path: Path) -> None:
    paths = written(tmp_path, "a", original()), written(tmp_path, "b", original())
    assert "so far apart in 100 % of cases" in run(*paths).output


def test_command_writes_table_and_page(tmp_path: Path) -> None:
    near = moved(np.array([0.0, 0.0, 1e-4, 0.01, 0.0, 0.0]))
    paths = [written(tmp_path, name, each) for name, each in (("a", original()), ("b", near), ("c", original()))]
    table, page = tmp_path / "table.csv", tmp_path / "page.html"
    ended = run(*paths, "--csv", table, "--page", page)
    assert ended.exit_code == 0, ended.output
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert len(rows) == 3
    assert float(rows[0]["d_objects_m"]) == pytest.approx(0.01, abs=1e-5)
    assert float(rows[1]["d_objects_m"]) == pytest.approx(0.0, abs=1e-6)
    assert "upper bound" in ended.output
    assert f"Written    {table}, {page}" in ended.output
    html = page.read_text()
    assert html.count("They agree") == 3
    assert "//" not in html.split("</style>")[1]
    again = run(*paths, "--csv", table)
    assert isinstance(again.exception, Exception)
    assert "overwrite" in str(again.exception)


def changed(**entries: object) -> dict[str, Any]:
    document = deepcopy(original())
    for name, value in entries.items():
        part = document
        *above, last = name.split("__")
        for key in above:
            part = part[key]
        part[last] = value
    return document


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({"sensor__name": "mast 8"}, ("name", "mast 8", "mast 7", "--renamed")),
        ({"sensor__kind": "lidar"}, ("kind", "lidar", "stereo")),
        ({"sensor__frame": "as in the scans"}, ("frame", "as in the scans")),
        ({"world__crs": "EPSG:32633"}, ("(EPSG:32633)", "(EPSG:32632)", "1000 m")),
        ({"world__crs": "EPSG:32602"}, ("(EPSG:32602)", "(EPSG:32632)", "1000 m")),
        ({"world__crs": "EPSG:32618"}, ("(EPSG:32618)", "(EPSG:32632)", "1000 m")),
        ({"world__origin_utm": [569797.0, 5463703.0]}, ("100034 m", "1000 m")),
        ({"T_world_sensor": (2 * np.eye(4)).tolist()}, ("T_world_sensor", "rotation")),
        ({"covariance": (-np.eye(6)).tolist()}, ("covariance", "eigenvalue")),
        ({"height_m": "high"}, ("height_m",)),
    ],
)
def test_what_is_no_second_result_of_the_sensor_is_refused(
    tmp_path: Path, entries: dict[str, object], words: tuple[str, ...]
) -> None:
    other = changed(**entries)
    moved_world = "world__origin_utm" in entries
    paths = written(tmp_path, "a", original()), written(tmp_path, "b", with_utm(other) if moved_world else other)
    with pytest.raises(CalibrationFileError) as refused:
        compare(paths)
    for word in (*words, str(paths[1])):
        assert word in str(refused.value)
    assert "\n" not in str(refused.value)


def test_other_name_can_be_said_to_be_the_same_sensor(tmp_path: Path) -> None:
    paths = written(tmp_path, "a", original()), written(tmp_path, "b", changed(sensor__name="mast 8"))
    assert compare(paths, renamed=True)[0].outcome == "agree"


@pytest.mark.parametrize("content", ["", "{", "[]", '{"schema": "laci-calibration/1"}', "\x00"])
def test_what_is_no_result_is_refused(tmp_path: Path, content: str) -> None:
    broken = tmp_path / "calibration.json"
    broken.write_text(content)
    with pytest.raises(CalibrationFileError, match=r"calibration\.json"):
        compare([tmp_path, tmp_path])


def test_one_result_is_too_few(tmp_path: Path) -> None:
    with pytest.raises(CalibrationFileError, match="at least 2"):
        compare([written(tmp_path, "a", original())])


def test_points_are_carried_by_both_transforms(tmp_path: Path) -> None:
    """The objects' difference is that of one point of the sensor's frame, put onto the map by both."""
    six = np.array([0.0, 0.0, 0.01, 0.3, 0.2, 0.0])
    one, other = stored(tmp_path, original()), stored(tmp_path, moved(six))
    place = one.centre_world + np.array([12.0, -7.0, 0.0])
    in_sensor = transform(invert(one.T_world_sensor), place[None])
    apart = np.linalg.norm((transform(other.T_world_sensor, in_sensor)[0] - place)[:2])
    found = compare_two(one, other, place[None, :2], place[None, :2]).differences[6].value
    assert found == pytest.approx(apart, rel=1e-9)


def test_results_that_share_a_drive_are_told_so(tmp_path: Path) -> None:
    for number, (_, found) in enumerate(recorded()[:2]):
        save(found, tmp_path / f"run{number}")
    same, others = (run(tmp_path / "run0", tmp_path / second).output for second in ("run0", "run1"))
    assert "both are of the same drive, of station 42 at 20" in same
    assert "same drive" not in others
