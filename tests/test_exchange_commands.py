"""Calibrations go to other tools and come from them, as a user does it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from scipy.spatial.transform import Rotation

from laci_stereo.commands.cli import cli
from laci_stereo.core.frames import invert, rigid
from laci_stereo.io.result.calibration_file import to_document, to_text
from laci_stereo.io.result.exports import FORMATS
from tests.cli_support import Ran, Site, document_in, refusal, run, run_installed, write_small_recording
from tests.report.page_support import PROVENANCE
from tests.report.support import calibration


def invoke(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, list(map(str, arguments)), standalone_mode=False)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("result")
    (folder / "calibration.json").write_text(to_text(to_document(calibration(), PROVENANCE)))
    return folder


def test_formats_are_listed_each_in_a_line() -> None:
    lines = invoke("export", "--list").output.splitlines()
    assert [line.split()[0] for line in lines] == [each.name for each in FORMATS]
    assert all(len(line) < 120 for line in lines)


@pytest.mark.parametrize("form", [each.name for each in FORMATS if each.name != "dair"])
def test_exported_to_a_file_or_to_standard_output_it_is_the_same(result: Path, tmp_path: Path, form: str) -> None:
    out = tmp_path / "out"
    assert invoke("export", result, "--to", form, "--out", out).exception is None
    said = invoke("export", result / "calibration.json", "--to", form)
    assert said.stdout == out.read_text()
    refused = invoke("export", result, "--to", form, "--out", out)
    assert "exists already; needed is another name, or --overwrite" in str(refused.exception)
    assert invoke("export", result, "--to", form, "--out", out, "--overwrite").exception is None


def test_two_files_go_into_a_folder(result: Path, tmp_path: Path) -> None:
    assert "needed is --out DIR" in str(invoke("export", result, "--to", "dair").exception)
    invoke("export", result, "--to", "dair", "--out", tmp_path / "dair")
    names = sorted(path.name for path in (tmp_path / "dair").iterdir())
    assert names == ["virtuallidar_to_camera.json", "virtuallidar_to_world.json"]


def test_nothing_to_export_says_what_is_needed(result: Path) -> None:
    assert "needed are a CALIBRATION and --to FORMAT, or --list" in str(invoke("export", result).exception)


def test_imported_result_is_compared_but_not_judged(result: Path, tmp_path: Path) -> None:
    matrix = tmp_path / "T.txt"
    invoke("export", result, "--to", "matrix", "--out", matrix)
    T = np.loadtxt(matrix)
    T[0, 3] += 0.25
    moved = tmp_path / "moved.txt"
    np.savetxt(moved, T, fmt="%.12f")
    document = document_in(result)
    world = document["world"]
    centre = np.array(world["origin_utm"]) + world["grid_scale"] * np.array(document["covariance_centre_world"][:2])
    said = invoke(
        *("import", moved, "--kind", "stereo", "--crs", world["crs"], "--name", document["sensor"]["name"]),
        *("--centre", "{},{}".format(*centre), "--out", tmp_path / "theirs"),
    )
    assert said.exception is None, said.output
    theirs = document_in(tmp_path / "theirs")
    assert (theirs["method"], theirs["covariance"], theirs["quality"]) == ("imported", None, None)
    theirs["sensor"] = document["sensor"]  # the words for the frame
    (tmp_path / "theirs" / "calibration.json").write_text(json.dumps(theirs))
    table, page = tmp_path / "table.csv", tmp_path / "page.html"
    compared = invoke("compare", result, tmp_path / "theirs", "--csv", table, "--page", page)
    assert compared.exception is None, compared.exception
    (east,) = [line for line in compared.output.splitlines() if line.startswith("|dx|")]
    assert east.split() == ["|dx|,", "east", "0.250", "m", "unknown"]
    assert "CANNOT TELL: one of them was imported and claims nothing" in compared.output
    row = table.read_text().splitlines()[1].split(",")
    assert (row[-1], row[-2], row[-3]) == ("cannot tell", "", "")
    assert "Nobody can tell whether they agree" in page.read_text()
    assert "nan" not in page.read_text().lower().split("</style>")[1].split("<footer")[0]


def test_an_existing_result_is_not_replaced(result: Path, tmp_path: Path) -> None:
    invoke("export", result, "--to", "opencv", "--out", tmp_path / "x.yaml")
    assert invoke("import", tmp_path / "x.yaml", "--out", tmp_path / "theirs").exception is None
    again = invoke("import", tmp_path / "x.yaml", "--out", tmp_path / "theirs")
    assert "holds a result already" in str(again.exception)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        (("--origin", "1"), r"--origin is '1'; needed are 2 or 3 numbers in metres, E,N"),
        (("--origin", "a,b"), r"--origin is 'a,b'; needed"),
        (("--centre", "1,2,3"), r"--centre is '1,2,3'; needed are 2 numbers"),
        (("--centre", "nan,2"), r"--centre is 'nan,2'; needed are 2 numbers"),
    ],
)
def test_options_that_make_no_sense(result: Path, tmp_path: Path, option: tuple[str, str], message: str) -> None:
    invoke("export", result, "--to", "opencv", "--out", tmp_path / "x.yaml")
    refused = invoke("import", tmp_path / "x.yaml", "--out", tmp_path / "theirs", *option)
    assert message in str(refused.exception)


def test_a_direction_is_read_or_asked_for(result: Path, tmp_path: Path) -> None:
    """In a map whose origin is far off to its side, the inverse of a sensor's pose is a possible one as well."""
    invoke("export", result, "--to", "matrix", "--out", tmp_path / "utm.txt")
    T = np.loadtxt(tmp_path / "utm.txt")
    crs = document_in(result)["world"]["crs"]
    rotation = Rotation.from_euler("x", 2.5, degrees=True).as_matrix()
    origin = T[:2, 3] - (0.0, 300.0)
    inverse = invert(rigid(rotation, np.array([0.0, 300.0, T[2, 3]])))[:3]
    options = ("--kind", "lidar", "--crs", crs, "--origin", "{!r},{!r}".format(*origin.tolist()))
    matrix, kitti = tmp_path / "T.txt", tmp_path / "calib.txt"
    np.savetxt(matrix, inverse, fmt="%.12f")
    kitti.write_text("Tr_map_to_lidar: " + " ".join(f"{value:.12f}" for value in inverse.ravel()))
    asked = invoke("import", matrix, *options, "--out", tmp_path / "asked")
    (line,) = str(asked.exception).splitlines()
    assert line.endswith("needed is --direction sensor-to-map or map-to-sensor")
    assert not (tmp_path / "asked").exists()
    for file, direction in ((matrix, ("--direction", "map-to-sensor")), (kitti, ())):
        said = invoke("import", file, *options, *direction, "--out", tmp_path / "theirs", "--overwrite")
        assert said.exception is None, said.exception
        found = document_in(tmp_path / "theirs")["T_utm_sensor"]
        np.testing.assert_allclose(np.array(found)[:3, 3], T[:3, 3], rtol=0, atol=1e-6)
    assert "note: transform Tr_map_to_lidar of calib.txt, map-to-sensor, as the file says" in said.stderr


@dataclass(frozen=True)
class Calibrated:
    """A small recording, and what the tool made of it with a map that does not state its system."""

    site: Site
    said: str


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Calibrated:
    root = tmp_path_factory.mktemp("recording")
    write_small_recording(root)
    site = Site(root)
    map_csv(root / "map.osm", root / "lines.csv")
    ran = site.run("--map", str(root / "lines.csv"), "--map-crs", "EPSG:32632")
    assert ran.code == 0, ran
    return Calibrated(site, ran.out + ran.err)


def map_csv(osm: Path, path: Path) -> None:
    from laci_stereo.core.world import World
    from laci_stereo.io.maps.lane_map import read_lane_map

    world = World.around(48.4226, 9.9434, "EPSG:32632")
    rows = ["id,x,y,type,subtype"]
    for line in read_lane_map(osm, world).lines:
        places = world.to_utm(line.xy).tolist()
        rows += [f"{line.id},{x!r},{y!r},{line.kind},{line.subtype}" for x, y in places]
    path.write_text("\n".join(rows) + "\n")


@pytest.mark.slow
def test_a_map_in_metres_serves_as_well(calibrated: Calibrated) -> None:
    assert "the map's coordinates are WGS 84 / UTM zone 32N, as --map-crs says" in calibrated.said
    document = document_in(calibrated.site.out)
    assert document["lane_check"]["verdict"] == "pass"
    assert document["config"]["map_crs"] == "EPSG:32632"


@pytest.fixture(scope="module")
def exported(calibrated: Calibrated, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported")
    ran = run_installed(["export", str(calibrated.site.out), "--to", "matrix", "--out", "T.txt"], folder)
    assert ran.code == 0, ran
    return folder / "T.txt"


@pytest.mark.slow
@pytest.mark.parametrize(("off_m", "code"), [(0.0, 0), (0.5, 1)])
def test_imported_result_is_held_against_the_map(
    calibrated: Calibrated, exported: Path, tmp_path: Path, off_m: float, code: int
) -> None:
    site = calibrated.site
    T = np.loadtxt(exported)
    T[1, 3] += off_m
    np.savetxt(tmp_path / "T.txt", T, fmt="%.12f")
    arguments = ["import", str(tmp_path / "T.txt"), "--kind", "stereo", "--crs", "EPSG:32632", "--out", "theirs"]
    imported = run_installed(arguments, tmp_path)
    assert imported.code == 0, imported
    lines = ["--map", str(site.root / "lines.csv"), "--map-crs", "EPSG:32632"]
    checked = run(["check", "theirs", str(site.left), *lines, "--picture", str(tmp_path / "check.png")], tmp_path)
    assert (checked.code, ("FAIL" if code else "PASS") in checked.out) == (code, True), checked
    assert "was imported and does not say how good it is; taken are 0.3 m and 0.5 deg in the plane" in checked.err


@pytest.mark.slow
def test_a_check_takes_the_baseline_that_the_result_was_made_with(calibrated: Calibrated, tmp_path: Path) -> None:
    """Of a rig whose lengths are in centimetres, as nothing in its file says."""
    site = calibrated.site
    centimetres = tmp_path / "stereo.yaml"
    entries = site.stereo.read_text()
    assert entries.count("-0.59999999999999998") == 1
    centimetres.write_text(entries.replace("-0.59999999999999998", "-60."))
    document = document_in(site.out)
    document["config"]["stereo"]["baseline_m"] = 0.6
    (tmp_path / "told").mkdir()
    (tmp_path / "told" / "calibration.json").write_text(json.dumps(document))

    def check(result: Path, *options: str) -> Ran:
        lines = ["--map", str(site.root / "lines.csv"), "--map-crs", "EPSG:32632", "--overwrite"]
        return run(["check", str(result), str(site.left), "--stereo", str(centimetres), *lines, *options], tmp_path)

    refusal(check(site.out), 2, "is 60 m; ", "--baseline M", "0.6 if T is in centimetres")
    told, asked = check(tmp_path / "told"), check(site.out, "--baseline", "0.6")
    assert (told.code, asked.code) == (0, 0), (told, asked)
    assert told.out == asked.out


def test_a_wrong_system_is_one_line(calibrated_site: tuple[Site, str], tmp_path: Path) -> None:
    site, _ = calibrated_site
    map_csv(site.root / "map.osm", tmp_path / "lines.csv")
    lines = ["--map", str(tmp_path / "lines.csv"), "--map-crs", "EPSG:32631"]
    ran = run(["check", str(site.out), str(site.left), *lines, "--picture", str(tmp_path / "check.png")], tmp_path)
    assert "km away from the track" in refusal(ran, 2)
