import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("embreex")

from laci_lidar.settings import LidarSettings
from scipy.spatial.transform import Rotation

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.frames import invert, rigid, transform
from tools.scenes.disparity import SPREAD, SURFACES, Mounted, StereoFlaws, match_frame, reproject, stereo_camera
from tools.scenes.geometry import Body, Material, Mesh, RayCaster
from tools.scenes.scene import STATION, Factors, Recorded, SceneError, draw_scene, errors_of, own_axes, swept_frame
from tools.scenes.sensors import LIDARS, Lidar, LidarFlaws, lidar, sweep
from tools.scenes.traffic import collide
from tools.scenes.world import LAYOUTS, draw_road, still
from tools.scenes.write import pcd, write_scene

WALL = Mesh(
    np.array([[10.0, -50.0, -50.0], [10.0, 50.0, -50.0], [10.0, -50.0, 50.0], [10.0, 50.0, 50.0]]),
    np.array([[0, 1, 2], [1, 3, 2]]),
    np.full(2, Material.WALL, dtype=np.int64),
)
WAYS = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
QUIET = {"vehicles": 0, "walkers": 0, "cyclists": 0, "stations": 0}


def finer(mesh: Mesh) -> Mesh:
    """Cut each triangle into sixteen."""
    for _ in range(2):
        a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
        d, e, f = (a + b) / 2, (b + c) / 2, (c + a) / 2
        corners = np.concatenate([np.stack(three, axis=1) for three in ((a, d, f), (d, b, e), (f, e, c), (d, e, f))])
        triangles = np.arange(3 * len(corners)).reshape(-1, 3)
        mesh = Mesh(corners.reshape(-1, 3), triangles, np.full(len(corners), Material.WALL, dtype=np.int64))
    return mesh


def facing_a_wall(name, flaws, frames=3):
    caster = RayCaster([Body("wall", WALL, still(np.eye(4)), True)])
    return np.concatenate([sweep(lidar(name), flaws, caster, np.eye(4), index, 5).points for index in range(frames)])


@pytest.mark.parametrize("name", LIDARS)
def test_ranges_scatter_as_the_data_sheet_says(name):
    scanner = replace(lidar(name), pointing_rad=(0.0, 0.0))
    caster = RayCaster([Body("wall", WALL, still(np.eye(4)), True)])
    points = np.concatenate([sweep(scanner, LidarFlaws(), caster, np.eye(4), index, 5).points for index in range(3)])
    near = points[(np.abs(points[:, 1]) < 5.0) & (np.abs(points[:, 2]) < 3.0)]
    ranges = np.linalg.norm(near, axis=1)
    true = 10.0 / (near[:, 0] / ranges)
    error = ranges - true
    n = len(error)
    assert n > 300
    assert error.std() == pytest.approx(lidar(name).range_sigma_m, rel=5 / np.sqrt(2 * n))
    assert abs(error.mean()) < 5 * lidar(name).range_sigma_m / np.sqrt(n)


@pytest.mark.parametrize(("way", "sign"), [("clockwise", -1.0), ("counter-clockwise", 1.0), ("at once", 0.0)])
def test_a_moving_wall_is_slanted_as_the_scanner_turns(way, sign):
    def away(time_s):
        T = np.eye(4)
        T[0, 3] = 5.0 * time_s
        return T

    scanner = replace(lidar("lidar_32").turning(way), range_sigma_m=0.0, pointing_rad=(0.0, 0.0))
    x, y, _ = sweep(scanner, LidarFlaws(), RayCaster([Body("wall", WALL, away, False)]), np.eye(4), 0, 5).points.T
    near = np.abs(y) < 4.0
    # It goes away by 5 m in a second, while bearing changes by a turn in 0.1 s: atan(y / 10 m) of it per metre.
    slope = np.polyfit(np.arctan2(y[near], x[near]), x[near], 1)[0]
    assert slope == pytest.approx(sign * 5.0 * 0.1 / (2 * np.pi), abs=1e-3)


def test_far_and_dark_things_return_less():
    near = len(facing_a_wall("lidar_32", LidarFlaws(), 1))
    scanner = lidar("lidar_32")
    far_wall = Mesh(WALL.vertices * [15.0, 15.0, 15.0], WALL.triangles, WALL.material)
    black = Mesh(WALL.vertices, WALL.triangles, np.full(2, Material.GLASS, dtype=np.int64))
    counts = []
    for mesh in (far_wall, black):
        caster = RayCaster([Body("wall", mesh, still(np.eye(4)), True)])
        counts.append(len(sweep(scanner, LidarFlaws(), caster, np.eye(4), 0, 5).points))
    # At 150 m a wall's power is 0.35 / 0.1 * (60 / 150)^2 = 0.56 of the threshold: 15 % return at best.
    assert counts[0] < 0.2 * near
    assert counts[1] < near


def test_rain_is_near_and_as_frequent_as_stated():
    dry, wet = facing_a_wall("lidar_16", LidarFlaws(), 5), facing_a_wall("lidar_16", LidarFlaws(rain=0.02), 5)
    beams = 5 * len(lidar("lidar_16").offset_s)
    drops = np.linalg.norm(wet, axis=1) < 9.0
    assert (np.linalg.norm(dry, axis=1) < 9.0).sum() == 0
    # Of drops at 1 / u, u uniform in 0.05 to 1, 94 % are within 9 m; 5 standard deviations.
    expected = 0.02 * beams * (1 - 1 / 9) / 0.95
    assert drops.sum() == pytest.approx(expected, abs=5 * np.sqrt(expected))


@pytest.mark.parametrize(
    "sensor", ["lidar_16", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("lidar_rosette", "stereo_05"))]
)
def test_scenes_follow_their_seed_and_show_the_sender(sensor):
    one, two, other = draw_scene(2, sensor), draw_scene(2, sensor), draw_scene(3, sensor)
    np.testing.assert_array_equal(one.T_utm_sensor, two.T_utm_sensor)
    np.testing.assert_array_equal(one.messages.latitude_deg, two.messages.latitude_deg)
    assert not np.allclose(one.T_utm_sensor, other.T_utm_sensor)
    assert one.seen >= 40
    clouds = [recorded for scene in (one, two) for recorded in _some_points(scene)]
    np.testing.assert_array_equal(*clouds)


def _some_points(scene):
    recorded = Recorded(scene)
    if isinstance(scene.sensor, Lidar):
        return [recorded.scan(50).points]
    return [recorded._cloud(50, whole=True).points]


@pytest.mark.parametrize("name", LIDARS)
def test_a_faster_scanner_fires_as_many_beams_a_second_and_a_slower_one_leaves_out_frames(name):
    own = lidar(name)
    fast, slow = own.at_rate(2.0 / own.period_s), own.at_rate(0.3 / own.period_s)
    layers = len(set(own.layer.tolist()))
    assert len(fast.azimuth_rad) / fast.period_s == pytest.approx(
        len(own.azimuth_rad) / own.period_s, abs=2 * layers / own.period_s
    )
    assert fast.offset_s.max() < fast.period_s == own.period_s / 2
    assert fast.field_rad == pytest.approx(own.field_rad, abs=np.radians(0.5))
    np.testing.assert_array_equal(slow.offset_s, own.offset_s)
    np.testing.assert_array_equal(slow.azimuth_rad, own.azimuth_rad)
    assert slow.period_s == pytest.approx(own.period_s / 0.3)


def test_scans_are_cut_where_they_begin():
    own = lidar("lidar_16")
    cut = own.beginning(30.0)
    assert np.degrees(cut.azimuth_rad[[0, -1]]) == pytest.approx([30.0, 30.0], abs=0.3)
    late_s = (np.radians(30.0) - cut.azimuth_rad) % (2 * np.pi) / (2 * np.pi) * own.period_s
    np.testing.assert_allclose(cut.offset_s, late_s, atol=1e-12)
    assert (np.diff(cut.offset_s) >= 0.0).all()
    np.testing.assert_allclose(own.beginning(180.0).offset_s, own.offset_s, atol=own.period_s / 1000)
    limited = lidar("lidar_8")
    assert limited.beginning(30.0) is limited


@pytest.mark.parametrize("sensor", ["lidar_8", "stereo_05"])
def test_at_another_frame_rate_the_same_drive_is_seen(sensor):
    anyhow = {"min_seen": 0, "min_driven_m": 0.0}
    own = draw_scene(4, sensor, **anyhow)
    for rate in (3.0, 25.0):
        other = draw_scene(4, sensor, frame_rate_hz=rate, **anyhow)
        np.testing.assert_allclose(np.diff(other.times_s), 1.0 / rate)
        assert np.ptp(other.times_s) == pytest.approx(np.ptp(own.times_s), abs=1.0 / rate + 0.1)
        np.testing.assert_array_equal(other.T_world_sensor, own.T_world_sensor)
        assert other.drive_kind == own.drive_kind
        assert other.seen / rate == pytest.approx(own.seen * own.sensor.period_s, abs=0.5)


def test_one_factor_changes_no_other():
    base, changed = draw_scene(4, "lidar_16", min_seen=0), draw_scene(4, "lidar_16", min_seen=0, receiver="dgnss")
    np.testing.assert_array_equal(base.T_world_sensor, changed.T_world_sensor)
    np.testing.assert_array_equal(base.messages.stamps_ns, changed.messages.stamps_ns)
    assert base.vehicle.length_m == changed.vehicle.length_m
    assert not np.array_equal(base.messages.latitude_deg, changed.messages.latitude_deg)


def test_a_mast_leans_about_its_foot_by_as_much_as_is_set():
    calm = draw_scene(4, "lidar_16", min_seen=0)
    gusts = replace(calm, factors=replace(calm.factors, lean_deg=0.2))
    times_s = np.arange(0.0, 300.0, 0.1)
    np.testing.assert_allclose(calm.T_world_sensor_at(3.0), calm.T_world_sensor, atol=1e-12)
    poses = np.array([gusts.T_world_sensor_at(time_s) for time_s in times_s])
    moved = poses @ invert(calm.T_world_sensor)
    tilts_deg = np.degrees(moved[:, [2, 0], [1, 2]])
    np.testing.assert_allclose(tilts_deg.std(axis=0), 0.2, rtol=0.1)
    np.testing.assert_allclose(tilts_deg.mean(axis=0), 0.0, atol=0.02)
    foot = np.array([*calm.T_world_sensor[:2, 3], 0.0, 1.0])
    np.testing.assert_allclose(moved @ foot, np.tile(foot, (len(times_s), 1)), atol=1e-9)
    index = np.argmax(np.abs(tilts_deg).sum(axis=1)) % len(calm.times_s)
    assert not np.array_equal(swept_frame(gusts, index).points, swept_frame(calm, index).points)


def test_stamps_miss_the_frames_by_as_much_as_is_set():
    exact = draw_scene(4, "lidar_16", min_seen=0)
    jittering = replace(exact, factors=replace(exact.factors, stamp_jitter_s=0.01))
    off_s = (jittering.stamps_ns - exact.stamps_ns) / 1e9
    assert off_s.std() == pytest.approx(0.01, rel=0.3)
    assert (np.diff(jittering.stamps_ns) > 0).all()
    np.testing.assert_array_equal(swept_frame(jittering, 7).points, swept_frame(exact, 7).points)


def test_what_is_set_is_so():
    scene = draw_scene(
        1, "lidar_32", height_m=5.0, tilt_deg=10.0, roll_deg=0.0, hanging="upside down", drive="left_turn", frames=95,
        vehicle="van", place="Sydney", left_hand=True,
    )  # fmt: skip
    assert scene.T_world_sensor[2, 3] == 5.0
    assert scene.vehicle.kind == "van"
    assert (scene.place.epsg, len(scene.times_s), scene.drive_kind) == (32756, 95, "left_turn")
    forward = scene.T_world_sensor[:3, :3] @ np.array(scene.axes.forward)
    up = scene.T_world_sensor[:3, :3] @ np.array(scene.axes.up)
    assert np.degrees(np.arcsin(-forward[2])) == pytest.approx(10.0)
    assert up[2] == pytest.approx(np.cos(np.radians(10.0)))
    # Hung upside down, the sensor's own z points down.
    assert scene.T_world_sensor[2, 2] < 0.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_company_comes_near_the_sender(seed):
    scene = draw_scene(seed, "lidar_16", vehicles=1, walkers=2, cyclists=0, near_m=2.0)
    times = np.arange(scene.times_s[0], scene.times_s[-1], 0.02)
    assert len(scene.others) >= 2
    for mover in scene.others:
        assert collide(mover, scene.sender, times, 2.0)
        assert not collide(mover, scene.sender, times[::10], 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_shrubs_stand_beside_the_road_and_lean_in_gusts_alone(seed):
    scene = draw_scene(seed, "lidar_16", shrubs=4, **QUIET)
    shrubs = [body for body in scene.bodies if body.name.startswith("shrub")]
    assert shrubs
    way = scene.sender.track(scene.times_s)[0]
    for shrub in shrubs:
        poses = np.stack([shrub.pose(time_s) for time_s in np.arange(0.0, 60.0, 0.1)])
        assert not scene.site.road.on_carriageway(poses[:, :2, 3]).any()
        assert np.linalg.norm(way - poses[0, :2, 3], axis=1).min() < 8.0
        upright = (poses[:, :3, :3] == poses[0, :3, :3]).all(axis=(1, 2)) | (poses[:, 2, 2] == 1.0)
        assert 0.5 < upright.mean() < 0.9
        assert np.degrees(np.arccos(poses[:, 2, 2])).max() < 4.0


def test_an_impossible_scene_is_refused(monkeypatch):
    monkeypatch.setattr("tools.scenes.scene.TRIES", 3)
    with pytest.raises(SceneError, match="does not fit"):
        draw_scene(0, "lidar_16", drive="roundabout", layout="cross")
    with pytest.raises(SceneError, match="in view"):
        draw_scene(0, "lidar_16", frames=5, min_seen=6)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_best_plane_of_the_carriageway_is_zero(layout):
    road = draw_road(np.random.default_rng(3), layout)
    grid = np.random.default_rng(1).uniform(-35.0, 35.0, (40_000, 2))
    on = grid[(np.linalg.norm(grid, axis=1) < 35.0) & road.on_carriageway(grid)]
    slope_x, slope_y, height = np.linalg.lstsq(np.column_stack([on, np.ones(len(on))]), road.height(on), rcond=None)[0]
    assert abs(height) < 2e-3
    assert max(abs(slope_x), abs(slope_y)) < 2e-4
    assert np.ptp(road.height(on)) > 0.005


@pytest.mark.parametrize(
    "hanging",
    ["x forward", "upside down", *(pytest.param(each, marks=pytest.mark.slow) for each in ("y forward", "-x forward"))],
)
def test_a_lidars_points_lie_on_what_they_hit(hanging):
    scene = draw_scene(6, "lidar_32", hanging=hanging, noise=0.0, systematic=0.0, rain=0.0)
    swept = swept_frame(scene, 50)
    points = transform(scene.T_world_sensor @ own_axes(scene), swept.points)
    np.testing.assert_allclose(points, transform(scene.T_world_sensor, Recorded(scene).scan(50).points), atol=1e-9)
    on_ground = points[(swept.body == 0) & (np.linalg.norm(points[:, :2] - scene.T_world_sensor[:2, 3], axis=1) < 15.0)]
    # Away from kerbs, whose steps a beam's width blurs.
    away = [scene.site.road.on_carriageway(on_ground[:, :2] + 0.2 * np.array(way)) for way in WAYS]
    on_road = on_ground[np.all(away, axis=0)]
    assert len(on_road) > 20
    apart = on_road[:, 2] - scene.site.road.height(on_road[:, :2])
    # A beam of 1.4 mrad is returned from within its width: 1 cm at 15 m; lines are 2 mm thick.
    assert np.abs(apart).max() < 0.03
    sender = points[swept.body == len(scene.bodies) - 1]
    times = float(scene.times_s[50]) + swept.offset_s[swept.body == len(scene.bodies) - 1]
    own = np.array([invert(scene.sender.pose(t)) @ np.append(p, 1.0) for t, p in zip(times, sender, strict=True)])
    assert len(own) > 20
    assert np.abs(own[:, 0]).max() < scene.vehicle.length_m / 2 + 0.15
    assert np.abs(own[:, 1]).max() < scene.vehicle.mirror_width_m / 2 + 0.15


SHARP = StereoFlaws(noise=0.0, bleed_px=0.0, gross=0.0, open_=0.0)


def facing_a_patchwork(material, flaws, frame=2, static=True):
    """Look at a wall 20 m away of 512 bodies, for texture belongs to bodies and triangles; return it and its errors."""
    corners = np.array([[-14.0, -8.0, 20.0], [-14.0, 8.0, 20.0], [14.0, -8.0, 20.0], [14.0, 8.0, 20.0]])
    cut = finer(finer(Mesh(corners, WALL.triangles, WALL.material)))
    pieces = [
        Mesh(cut.vertices[three], np.arange(3)[None], np.array([material], dtype=np.int64)) for three in cut.triangles
    ]
    bodies = [Body(f"piece {number}", mesh, still(np.eye(4)), static) for number, mesh in enumerate(pieces)]
    mounted = Mounted(stereo_camera("stereo_05", 1000.0), RayCaster(bodies), np.eye(4))
    matched = match_frame(mounted, flaws, 0.0, (1, frame))
    return mounted, matched, matched.disparity_px - 1000.0 * 0.5 / 20.0


def test_disparity_of_a_plane_is_exact_without_flaws():
    mounted, exact, _ = facing_a_patchwork(Material.WALL, SHARP)
    points = reproject(mounted.camera, 0, exact, np.ones_like(exact.moving)).points
    np.testing.assert_allclose(points[:, 2], 20.0, atol=1e-9)
    # Only what is to the left of the right image's border has no partner: 25 px.
    assert np.isfinite(exact.disparity_px[:, 9:]).mean() > 0.999


def test_disparity_scatters_as_the_material_does_and_over_windows():
    _, noisy, error = facing_a_patchwork(Material.CAR_PAINT, replace(SHARP, noise=0.3))
    known = np.isfinite(error)
    # The mean logarithm of a normal number's size is -(0.577 + ln 2) / 2. 512 bodies and as many triangles, a third of
    # the logarithm's variance of 0.36 each: 0.02.
    middle = np.exp(np.log(np.abs(error[known])).mean() + (np.euler_gamma + np.log(2.0)) / 2)
    assert middle == pytest.approx(0.3 * SURFACES[Material.CAR_PAINT].sigma_px, rel=0.08)
    # What is told is the floor of 0.1 px, and half of the rest.
    scaled = error / (2 * np.sqrt(noisy.sigma_px**2 - 0.01))
    assert np.nanstd(scaled) == pytest.approx(1.0, abs=0.05)
    for cells, expected in ((1, 0.87), (3, 0.28)):
        beside = np.nanmean(scaled[:, cells:] * scaled[:, :-cells]) / np.nanvar(scaled)
        assert beside == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize(("static", "expected"), [(True, 0.7), (False, 0.0)])
def test_noise_lasts_where_nothing_moves(static, expected):
    flaws = replace(SHARP, noise=0.3, lasting=0.7)
    one, other = (facing_a_patchwork(Material.WALL, flaws, frame, static)[2] for frame in (2, 3))
    # A third of the variance of the logarithm of the noise's size, 0.36, differs between frames as well.
    alike = np.nanmean(one * other) / np.sqrt(np.nanmean(one**2) * np.nanmean(other**2))
    assert alike == pytest.approx(np.exp(-(SPREAD**2) / 3) * expected, abs=0.05)


def test_as_much_is_open_and_gross_as_the_material_says():
    glass = SURFACES[Material.GLASS]
    _, gaps, _ = facing_a_patchwork(Material.GLASS, replace(SHARP, open_=1.0, noise=0.3))
    assert np.isnan(gaps.disparity_px[:, 9:]).mean() == pytest.approx(glass.open_, abs=0.05)
    _, _, error = facing_a_patchwork(Material.GLASS, replace(SHARP, gross=1.0))
    far_off = np.abs(error[np.isfinite(error)]) >= 1.0
    # Some 3000 patches of 5 px.
    assert far_off.mean() == pytest.approx(glass.gross, abs=0.02)
    # Of what is matched the middle one has the noise that is stated, whatever share is open; half of it is told.
    noise = 2 * np.sqrt(gaps.sigma_px[np.isfinite(gaps.sigma_px)] ** 2 - 0.01)
    assert np.median(noise) == pytest.approx(0.3 * glass.sigma_px, rel=0.08)
    # The speckle filter drops what is smaller than 100 px: mismatches come in patches, not alone.
    wrong = np.nan_to_num(np.abs(error)) >= 1.0
    assert (wrong[:, 1:] & wrong[:, :-1]).sum() > 0.5 * wrong.sum()


def test_what_a_near_thing_hides_from_the_right_camera_is_not_matched():
    camera = stereo_camera("stereo_10", 1000.0)
    quad = WALL.vertices[:, [1, 2, 0]]
    back = Mesh(quad * [2.0, 2.0, 4.0], WALL.triangles, np.full(2, Material.FOLIAGE, dtype=np.int64))
    post = Mesh(quad * [0.01, 1.0, 1.0], WALL.triangles, np.full(2, Material.FOLIAGE, dtype=np.int64))
    caster = RayCaster([Body(name, mesh, still(np.eye(4)), True) for name, mesh in (("back", back), ("post", post))])
    matched = match_frame(Mounted(camera, caster, np.eye(4)), SHARP, 0.0, (1, 2))
    open_share = np.isnan(matched.disparity_px).mean(axis=0)
    u = camera.pixels[0][0]
    # The post spans u from -50 to 50 at 100 px; the wall has 25 px: it is hidden for 75 px to the left of the post.
    assert (open_share[(u > -120.0) & (u < -55.0)] == 1.0).all()
    assert (open_share[(u > 60.0) & (u < 300.0)] < 0.2).all()
    assert (open_share[(u > -300.0) & (u < -135.0)] < 0.2).all()


def test_bleeding_makes_near_things_grow():
    camera = stereo_camera("stereo_05", 1000.0)
    quad = WALL.vertices[:, [1, 2, 0]]
    back = Mesh(quad * [2.0, 2.0, 4.0], WALL.triangles, np.full(2, Material.FOLIAGE, dtype=np.int64))
    post = Mesh(quad * [0.01, 1.0, 1.0], WALL.triangles, np.full(2, Material.FOLIAGE, dtype=np.int64))
    caster = RayCaster([Body(name, mesh, still(np.eye(4)), True) for name, mesh in (("back", back), ("post", post))])
    widths = []
    for bleed in (0.0, 3.0):
        matched = match_frame(Mounted(camera, caster, np.eye(4)), replace(SHARP, bleed_px=bleed), 0.0, (1, 2))
        widths.append((matched.disparity_px > 40.0).sum() / len(matched.disparity_px) * camera.stride)
    # By the bleeding on either side.
    assert widths[1] - widths[0] == pytest.approx(6.0, abs=1.0)


@pytest.mark.parametrize(
    ("material", "across_m", "least", "most"),
    [(Material.CAR_PAINT, 1.0, 0.9, 1.0), (Material.CAR_PAINT, 20.0, 0.0, 0.4), (Material.ROAD, 1.0, 0.0, 0.0)],
    ids=["grazed paint", "paint from the front", "grazed road"],
)
def test_what_a_grazed_side_mirrors_is_behind_it(material, across_m, least, most):
    # A wall of so much width leads 10 m away from before the camera, on its right.
    corners = np.array([[2.0, -3.0, 10.0], [2.0, 3.0, 10.0], [2.0 + across_m, -3.0, 20.0], [2.0 + across_m, 3.0, 20.0]])
    wall = Mesh(corners, WALL.triangles, np.full(2, material, dtype=np.int64))
    mounted = Mounted(stereo_camera("stereo_05"), RayCaster([Body("wall", wall, still(np.eye(4)), True)]), np.eye(4))
    matt, glossy = (match_frame(mounted, replace(SHARP, gloss_px=by), 0.0, (1, 2)).disparity_px for by in (0.0, 1.0))
    known = np.isfinite(matt) & np.isfinite(glossy)
    assert known.sum() > 100
    assert least <= np.median((matt - glossy)[known]) <= most
    assert (glossy[known] <= matt[known]).all()


@pytest.mark.slow
@pytest.mark.parametrize("sensor", ["lidar_64", "stereo_10"])
def test_an_easy_scene_is_calibrated_to_a_part_of_a_car(sensor):
    easy = {"uneven": 0.0, "land": 0.0, "receiver": "exact", "lever_sigma_m": 0.0, "height_m": 6.0, "density": 0.3}
    scene = draw_scene(11, sensor, drive="left_turn", vehicle="saloon", speed_mps=6.0, **easy, **QUIET)
    errors = errors_of(calibrate(Recorded(scene), scene.messages, crs=scene.crs), scene)
    # Centres of what is visible of a car are off by half its width at most, in the middle of a drive by less.
    assert errors.track_xy_cm < 100.0
    assert errors.rotation_deg < 3.0


def exact(scene, station_id=STATION):
    """Return a calibration without an error, that claims 0.1 m and some angles about the middle of the track."""
    middle = scene.track_utm_of(station_id).mean(axis=0)
    return SimpleNamespace(
        world=SimpleNamespace(crs=scene.crs, from_utm=lambda utm: utm - middle),
        T_utm_sensor=scene.T_utm_sensor.copy(),
        drive=SimpleNamespace(station_id=station_id),
        covariance=np.diag([0.0, 0.0, 0.0, 0.005, 0.005, 0.0]),
        centre_world=np.zeros(3),
        quality=SimpleNamespace(yaw_sigma_deg=0.2, tilt_sigma_deg=0.1),
    )


def test_errors_count_where_the_vehicle_drove_that_was_taken():
    # A turn about the middle of another's track moves what is there by less than what is elsewhere.
    scene = draw_scene(7, "lidar_16", vehicles=1, stations=1)
    its = scene.track_utm_of(STATION + 1)
    its = its[np.linalg.norm(its - scene.T_utm_sensor[:2, 3], axis=1) < 60.0]
    about = rigid(np.eye(3), np.append(its.mean(axis=0), 0.0))
    turn = rigid(Rotation.from_rotvec([0.0, 0.0, 1.0], degrees=True).as_matrix(), np.zeros(3))
    turned = exact(scene, STATION + 1)
    turned.T_utm_sensor = about @ turn @ np.linalg.inv(about) @ scene.T_utm_sensor
    expected_m = 2.0 * np.sin(np.radians(0.5)) * np.sqrt(((its - its.mean(axis=0)) ** 2).sum(axis=1).mean())
    assert errors_of(turned, scene).track_xy_cm == pytest.approx(100.0 * expected_m, rel=1e-6)


def test_errors_are_held_against_what_is_claimed_where_they_are():
    scene = draw_scene(7, "lidar_16")
    found = exact(scene)
    found.T_utm_sensor[0, 3] += 0.05
    assert errors_of(found, scene).sigma_ratio == pytest.approx(0.5, rel=1e-6)
    found.covariance[2, 2] = np.radians(1.0) ** 2
    track = scene.track_utm[np.linalg.norm(scene.track_utm - scene.T_utm_sensor[:2, 3], axis=1) < 60.0]
    away = np.sqrt(((track - scene.track_utm.mean(axis=0)) ** 2).sum(axis=1).mean())
    assert errors_of(found, scene).sigma_ratio == pytest.approx(0.05 / np.hypot(0.1, np.radians(1.0) * away), rel=1e-6)


def test_errors_of_the_truth_are_nothing():
    scene = draw_scene(7, "lidar_16")
    found = exact(scene)
    errors = errors_of(found, scene)
    assert errors.track_xy_cm == pytest.approx(0.0, abs=1e-4)
    assert errors.rotation_deg == pytest.approx(0.0, abs=1e-6)
    turned = scene.T_utm_sensor.copy()
    turned[0, 3] += 0.05
    found.T_utm_sensor = turned
    assert errors_of(found, scene).track_xy_cm == pytest.approx(5.0, abs=1e-3)
    for turn, ratio in ((np.array([0.0, 0.0, 1.0]), 5.0), (np.array([0.6, 0.8, 0.0]), 10.0)):
        R = Rotation.from_rotvec(turn, degrees=True).as_matrix()
        found.T_utm_sensor = scene.T_utm_sensor.copy()
        found.T_utm_sensor[:3, :3] = R @ scene.T_utm_sensor[:3, :3]
        assert errors_of(found, scene).rotation_ratio == pytest.approx(ratio, rel=1e-3)


def test_a_data_set_is_what_was_simulated(tmp_path: Path):
    from laci_lidar.folder import ScanFolder
    from laci_lidar.recording import LidarRecording

    from laci_stereo.core.messages.stations import world_around
    from laci_stereo.io.cam.csv_log import read_cam_csv
    from laci_stereo.io.maps.lane_map import read_lane_map

    scene = draw_scene(8, "lidar_16", frames=60, point_times=True, turning="counter-clockwise", **QUIET)
    write_scene(scene, tmp_path)
    scans = ScanFolder.open(tmp_path / "lidar_16")
    np.testing.assert_array_equal(scans.stamps_ns, scene.stamps_ns)
    read = next(LidarRecording(scans, LidarSettings(axes=scene.axes)).__iter__())
    own = Recorded(scene).scan(0)
    own_points = own.points[np.linalg.norm(own.points, axis=1) >= 1.0]
    np.testing.assert_allclose(read.points, own_points, atol=2e-5)
    assert read.offset_s is not None
    log = read_cam_csv(tmp_path / "cam.csv").log
    np.testing.assert_allclose(log.latitude_deg, scene.messages.latitude_deg, atol=1e-9)
    np.testing.assert_array_equal(log.stamps_ns, scene.messages.stamps_ns)
    world = world_around(log, scene.crs)
    assert len(read_lane_map(tmp_path / "map.osm", world).lines) == len(scene.site.lines) + len(scene.site.edges)
    truth = json.loads((tmp_path / "truth.json").read_text())
    np.testing.assert_allclose(truth["lidar"]["lidar_16"]["T_world_lidar_utm"], scene.T_utm_sensor)


def test_pcd_holds_single_precision():
    content = pcd(np.arange(8.0).reshape(2, 4))
    assert b"FIELDS x y z intensity" in content
    np.testing.assert_array_equal(np.frombuffer(content[-32:], "<f4"), np.arange(8.0))


def test_every_factor_is_described():
    words = Factors.__doc__ or ""
    for name in Factors.__dataclass_fields__:
        assert name in words, name
