"""What the report page says, read as a browser reads it."""

from __future__ import annotations

import base64
import hashlib
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, invert, planar
from laci_stereo.core.result import Calibration
from laci_stereo.core.world import World
from laci_stereo.io.result.calibration_file import Provenance
from laci_stereo.report.drawn import drives_of, sender_track
from laci_stereo.report.page import Made, Photograph, Photographs
from laci_stereo.report.page.photo import MOST_BYTES, jpeg
from tests.passages import passages, recorded
from tests.report.page_support import PROVENANCE, Element, distances_to, page, points_of, read, with_images
from tests.report.support import (
    HEIGHT_M,
    LENGTH_M,
    SENSOR_XY,
    WIDTH_M,
    calibration,
    drive,
    lane,
    lane_map,
    lens,
    pixel,
    with_drive,
)

LARGEST = 8_000_000
HOSTILE = "</title></script><script>alert(1)</script><img src=x onerror='alert(2)'>\"'`{{ 7*7 }}&amp;"


def matrix(of: Element, name: str) -> np.ndarray:
    return np.array(json.loads(of.one("pre", data_name=name).text))


def layer(of: Element, key: str) -> Element:
    (found,) = (each for each in of.all("g", data_of=key) if f"key-{key}" in each.classes)
    return found


# ------------------------------------------------------------------------------------- the numbers


@pytest.mark.parametrize("axes", [None, FORWARD_LEFT_UP_AXES])
def test_the_transforms_are_the_calibrations(axes: object) -> None:
    true = calibration() if axes is None else calibration(FORWARD_LEFT_UP_AXES)
    T_sensor_rectified = planar(0.1, np.zeros(2))
    provenance = replace(PROVENANCE, T_sensor_rectified=T_sensor_rectified)
    shown = read(page(true, Made(provenance, "")))
    np.testing.assert_allclose(matrix(shown, "T_utm_sensor"), true.T_utm_sensor, rtol=0, atol=1e-9)
    np.testing.assert_allclose(matrix(shown, "T_world_sensor"), true.T_world_sensor, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        matrix(shown, "T_world_rectified"), true.T_world_sensor @ T_sensor_rectified, rtol=0, atol=1e-9
    )


def test_by_how_much_a_rigid_transform_is_off_is_the_places_own_scale() -> None:
    """In the middle of a UTM zone 4 cm in 100 m, at its edge on the equator 10 cm."""
    for longitude_deg, off_cm in ((9.0, 4), (12.0, 10)):
        world = World.around(0.0, longitude_deg, "EPSG:32632")
        assert f"makes {off_cm} cm in 100 m" in page(with_drive(calibration(), world=world), Made(PROVENANCE, ""))


def test_place_and_direction_are_what_they_are() -> None:
    facts = {row.one("th").text: row.one("td", look="value").text for row in read(page(calibration())).all("tr")[:7]}
    east, north = 569797.0 + 0.99966 * SENSOR_XY[0], 5363703.0 + 0.99966 * SENSOR_XY[1]
    assert facts["Position"] == f"E {east:.3f} m, N {north:.3f} m"
    assert facts["Height"].startswith(f"{HEIGHT_M:.3f} m")
    assert facts["Looks to"].startswith("90.000°")
    assert facts["Looks down"].startswith("15.000°")
    # Grid north is 0.7 deg east of true north at Ulm, which lies east of its zone's central meridian.
    assert 0.6 < float(facts["Compass bearing"].rstrip("°")) < 0.8


@pytest.mark.parametrize(("verdict", "words"), [("pass", "can be used"), ("warn", "with care"), ("fail", "Do not use")])
def test_the_verdict_comes_first_with_its_reasons_and_what_to_do(verdict: str, words: str) -> None:
    true = calibration()
    quality = replace(true.quality, verdict=verdict, reasons=("yaw is vague",), advice="drive a turn")
    section = read(page(replace(true, quality=quality))).all("section")[0]
    assert words in section.text
    assert "yaw is vague" in section.text
    assert "drive a turn" in section.text


def test_every_setting_input_and_note_is_there() -> None:
    made = replace(Made(PROVENANCE, "47 image pairs"), skipped=("left/9.png is damaged",), command="laci-stereo x --y")
    true = calibration()
    true = replace(true, quality=replace(true.quality, left_out={"cut": 3}))
    shown = read(page(true, made))
    settings = {row.one("th").text: row.one("td").text for row in shown.one("section", id="settings").all("tr")[1:]}
    assert settings == {"method": '"joint"', "joint.clock_sigma_s": "0.01", "joint.block_s": "1.0", "workers": "0"}
    inputs = shown.one("section", id="inputs").text
    for words in ("ab" * 32, "47 files", "2 left images without a partner", "left/9.png is damaged", "3 frames cut by"):
        assert words in inputs
    assert "laci-stereo x --y" in shown.one("section", id="made").text


def test_a_page_from_python_says_so() -> None:
    assert "from Python" in read(page(calibration())).one("section", id="made").text


def test_the_papers_method_stands_beside() -> None:
    true = calibration()
    assert true.paper_differs is not None
    shown = read(page(true)).one("section", id="paper").text
    assert f"{true.paper_differs[0]:.3f} m apart" in shown
    assert f"+{np.degrees(0.01):.3f}°" in shown
    assert "no answer" in read(page(replace(true, paper=None))).one("section", id="paper").text


@pytest.mark.slow
def test_each_drive_has_its_own_track_by_the_messages() -> None:
    true = recorded()[0][1]
    others = [replace(one, match=true.drive.match) for one in passages()[1:]]
    own = replace(true.drive, body=true.drive.vehicle)
    combined = replace(true, passages=(own, *others))
    tracks = [sender_track(drive) for drive in drives_of(combined)]
    vehicles = [one.body or one.vehicle for one in combined.passages]
    assert len(tracks) == len(vehicles) > 1
    for (track,), vehicle in zip(tracks, vehicles, strict=True):
        assert track[0] == pytest.approx(vehicle.xy[0], abs=1e-6)


@pytest.mark.slow
def test_the_drives_of_several_are_named() -> None:
    true = recorded()[0][1]
    others = [replace(one, match=true.drive.match) for one in passages()[1:]]
    combined = replace(true, passages=(true.drive, *others))
    shown = read(page(combined, Made(replace(PROVENANCE, kind="lidar"), "")))
    rows = shown.one("section", id="drives").all("tr")[1:]
    assert [row.all("td")[0].text for row in rows] == ["42", "43", "44"]
    assert "run 2" in rows[2].text
    assert "drives" not in [section.attributes["id"] for section in read(page(true)).all("section")]


# ------------------------------------------------------------------------------------- the pictures


def test_lines_of_the_map_are_projected_as_the_camera_sees_them() -> None:
    shown = read(page(calibration(), with_images()))
    ids = [use.attributes["href"].lstrip("#") for use in layer(shown.one("figure", look="photo"), "lanes").all("use")]
    d = shown.one("path", id=ids[0]).attributes["d"]
    ends = np.array([pixel((1.0, y, 0.0), lens()) for y in (12.0, 30.0)], dtype=np.float64)
    assert distances_to(d, ends).max() < 1.0  # `pixel` gives whole ones


def test_lines_bend_with_the_lens() -> None:
    barrel = lens(distortion=np.array([-0.2, 0.05, 0.0, 0.0, 0.0]))
    true = calibration()
    shown = read(page(true, with_images(barrel)))
    ids = [use.attributes["href"].lstrip("#") for use in layer(shown.one("figure", look="photo"), "lanes").all("use")]
    d = shown.one("path", id=ids[0]).attributes["d"]
    along = np.column_stack([np.full(37, 1.0), np.linspace(12.0, 30.0, 37), np.zeros(37)])
    T = invert(true.T_world_sensor)
    expected, _ = cv2.projectPoints(along, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], barrel.K, barrel.distortion)
    assert distances_to(d, expected.reshape(-1, 2)).max() < 0.1


@pytest.mark.parametrize("key", ["sent-box", "seen-box"])
def test_both_boxes_stand_around_the_vehicle_in_each_frame(key: str) -> None:
    shown = read(page(calibration(), with_images()))
    shots = [each for each in shown.all("g") if "data-shot" in each.attributes]
    assert len(shots) == 2
    for stamp_s, shot in zip((1.5, 3.5), shots, strict=True):
        xy, yaw = drive(np.array([stamp_s]))
        ahead = np.array([np.cos(yaw[0]), np.sin(yaw[0])])
        half = np.array([[a * LENGTH_M / 2, b * WIDTH_M / 2] for a in (1, -1) for b in (1, -1)])
        corners = xy[0] + half[:, :1] * ahead + half[:, 1:] * np.array([-ahead[1], ahead[0]])
        pixels = np.array([pixel((x, y, 0.0), lens()) for x, y in corners], dtype=np.float64)
        (ident,) = {use.attributes["href"].lstrip("#") for use in layer(shot, key).all("use")}
        assert distances_to(shown.one("path", id=ident).attributes["d"], pixels).max() < 1.0


def test_images_are_in_the_page_and_are_the_cameras() -> None:
    made = with_images()
    assert made.photographs is not None
    images = read(page(calibration(), made)).all("image")
    assert len(images) == 2
    for image in images:
        kind, _, content = image.attributes["href"].partition(",")
        assert kind == "data:image/jpeg;base64"
        decoded = cv2.imdecode(np.frombuffer(base64.b64decode(content), np.uint8), cv2.IMREAD_COLOR)
        assert decoded is not None
        assert np.abs(decoded.astype(int) - made.photographs.shots[0].image).mean() < 2.0


def test_sensors_without_images_have_a_page_without_them() -> None:
    shown = read(page(calibration(FORWARD_LEFT_UP_AXES)))
    assert shown.all("image") == []
    assert "image" not in [section.attributes["id"] for section in shown.all("section")]


def test_the_map_puts_tracks_and_sensor_where_they_are() -> None:
    true = calibration()
    shown = read(page(true, Made(PROVENANCE, "", lane_map=lane_map(lane((-5.0, 20.0), (9.0, 20.0))))))
    figure = shown.one("figure", look="map")
    sent = layer(figure, "sent").one("path").attributes["d"]
    np.testing.assert_allclose(distances_to(sent, drive(np.array([0.0, 1.2, 4.0, 5.0]))[0]), 0.0, atol=2e-3)
    seen = points_of(layer(figure, "seen").one("path").attributes["d"])
    np.testing.assert_allclose(seen, drive(true.drive.track.stamps_s)[0], atol=2e-3)
    assert points_of(layer(figure, "lanes").one("path").attributes["d"]).tolist() == [[-5.0, 20.0], [9.0, 20.0]]
    foot = layer(figure, "sensor").one("path", look="sensor dots").attributes["d"]
    np.testing.assert_allclose(points_of(foot), SENSOR_XY[None], atol=1e-3)


def test_north_is_up_and_metres_are_square_on_the_map() -> None:
    figure = read(page(calibration())).one("figure", look="map")
    (group,) = (each for each in figure.all("g") if each.attributes.get("transform", "").startswith("matrix"))
    a, b, c, d, _, _ = map(float, group.attributes["transform"][len("matrix(") : -1].split())
    assert (b, c) == (0.0, 0.0)
    assert a == pytest.approx(-d)
    assert a > 0
    assert a == pytest.approx(float(figure.attributes["data-scale"]), abs=1e-5)


def test_ellipses_are_as_wide_as_the_doubt() -> None:
    true = replace(calibration(), covariance=np.diag([0.0, 0.0, 0.0, 0.09, 0.04, 0.0]))
    ellipses = layer(read(page(true)).one("figure", look="map"), "doubt").all("path")
    for sigmas, ellipse in zip((1.0, 3.0), ellipses, strict=True):
        first = points_of(ellipse.attributes["d"].split("Z")[0])
        np.testing.assert_allclose(np.ptp(first, axis=0) / 2, sigmas * np.array([0.3, 0.2]), rtol=0.01)


def test_moments_tell_how_far_the_sensors_box_is_from_the_messages() -> None:
    moments = json.loads(read(page(calibration())).one("figure", look="map").attributes["data-moments"])
    assert len(moments) == 31
    assert "t = 1.00 s" in moments[0][2]
    assert "+0.00 m ahead" in moments[0][2].replace("-0.00", "+0.00")


# ------------------------------------------------------------------------------------- what it must not be


def full(true: Calibration, provenance: Provenance = PROVENANCE) -> str:
    return page(true, replace(with_images(), provenance=provenance))


def test_nothing_is_asked_from_outside() -> None:
    shown = read(full(calibration()))
    for element in shown.inside:
        for name, value in element.attributes.items():
            if name in {"href", "src", "srcset", "action", "data", "poster", "xlink:href"}:
                assert value.startswith(("#", "data:")), (element.tag, name)
            assert not name.startswith("on")
            assert name != "style"  # the policy would not let it in
    style = shown.one("style").text
    assert "@import" not in style
    assert "url(" not in style
    assert "://" not in style + shown.one("script").text


def test_the_policy_lets_in_this_style_and_script_alone() -> None:
    shown = read(full(calibration()))
    policy = shown.one("meta", http_equiv="Content-Security-Policy").attributes["content"]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "data:"
    for tag in ("style", "script"):
        digest = base64.b64encode(hashlib.sha256(shown.one(tag).text.encode()).digest()).decode()
        assert rules[f"{tag}-src"] == f"'sha256-{digest}'"


def test_what_comes_from_files_is_never_markup() -> None:
    provenance = Provenance(
        name=HOSTILE,
        kind="stereo",
        frame=HOSTILE,
        inputs={HOSTILE: "0" * 64},
        config={HOSTILE: HOSTILE},
        notes=(HOSTILE,),
    )
    true = calibration()
    true = replace(true, quality=replace(true.quality, reasons=(HOSTILE,), advice=HOSTILE))
    lanes = lane_map(lane((1.0, 12.0), (1.0, 30.0), kind=HOSTILE, subtype=HOSTILE))
    plain = read(full(calibration()))
    made = replace(with_images(), provenance=provenance, read=HOSTILE, skipped=(HOSTILE,), command=HOSTILE)
    shown = read(page(true, replace(made, lane_map=lanes)))
    assert len(shown.all("script")) == len(plain.all("script")) == 1
    assert shown.all("img") == []
    assert shown.one("script").text == plain.one("script").text
    assert HOSTILE in shown.one("title").text
    for section in ("verdict", "transform", "inputs", "settings", "made"):
        assert HOSTILE in shown.one("section", id=section).text
    assert any(HOSTILE in each.attributes.get("data-tip", "") for each in shown.all("path"))


def test_it_stays_small_whatever_the_camera_sees() -> None:
    noise = np.random.default_rng(0).integers(0, 65536, (2160, 3840), dtype=np.uint16)
    assert len(jpeg(noise)) <= MOST_BYTES * 4 / 3 + 4
    small = noise[:72, :128]
    through = lens(3840, 2160)
    shots = Photographs(through, tuple(Photograph(1.0 + 0.5 * number, noise) for number in range(6)))
    made = replace(with_images(), photographs=shots)
    assert len(full(calibration()).encode()) < LARGEST
    assert len(page(calibration(), made).encode()) < LARGEST
    assert cv2.imdecode(np.frombuffer(base64.b64decode(jpeg(small)), np.uint8), 0).shape == (72, 128)


def test_a_long_drive_on_a_large_map_stays_small() -> None:
    true = calibration()
    sightings = true.drive.track.sightings * 200
    long = with_drive(true, track=replace(true.drive.track, sightings=sightings))
    rng = np.random.default_rng(1)
    lanes = lane_map(*(lane(*map(tuple, np.cumsum(rng.normal(0, 2, (50, 2)), axis=0))) for _ in range(500)))
    assert len(page(long, replace(with_images(), lane_map=lanes)).encode()) < LARGEST


def test_what_is_not_known_leaves_a_page_all_the_same() -> None:
    true = calibration()
    unknown = replace(true.drive.vehicle, stamps_s=true.drive.vehicle.stamps_s + 100.0)
    shown = read(page(with_drive(true, vehicle=unknown)))
    assert "No frame of this drive can be compared" in shown.text
