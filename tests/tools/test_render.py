"""Rendered images show what the lens projects, where it projects it, and as noisy as the sensor is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from laci_stereo.core.frames import FloatArray, invert, rigid, transform
from laci_stereo.io.rig.stereo_calibration import read_stereo_calibration
from laci_stereo.io.rig.stereo_rig import StereoRig
from laci_stereo.stereo.rectify import bouguet, undistorted
from tests.stereo.rigs import EIGHT, FISHEYE, FIVE, lens, rig
from tools.scenes.cameras import looking, mistold, project, random_mount, random_rig, rays, write_calibration
from tools.scenes.compare_disparity import errors_in, exact_truth, matched_frames
from tools.scenes.disparity import stereo_camera
from tools.scenes.geometry import Body, Material, Mesh, RayCaster
from tools.scenes.imager import Sensor, develop
from tools.scenes.render import Eye, Look, Renderer, eyes, stereo_pairs, write_stereo
from tools.scenes.shading import Light, sun_at
from tools.scenes.textures import BLUR, noise

CLEAR = Light(sun_at(40.0, 35.0), np.array([0.8, 0.76, 0.7]), np.array([0.15, 0.19, 0.26]), 0.0)
GREY = Sensor(colour=False, right_gain=1.1)
SMALL = (240, 180)
ASKEW = rig(lens(FIVE, size=SMALL), lens(EIGHT, focal=1.06, shift=(-8.0, 6.0), size=SMALL), (1.2, 1.5, -1.0))
LENSES = {
    "ideal": lens(size=SMALL),
    "five": lens(FIVE, size=SMALL),
    "fisheye": lens(FISHEYE, "fisheye", 0.8, size=SMALL),
}


def squares(count: int, side_m: float, materials: tuple[Material, Material]) -> Mesh:
    """Squares in the plane z = 0 around the origin, in two materials by turns."""
    edge = (np.arange(count + 1) - count / 2) * side_m
    x, y = np.meshgrid(edge, edge)
    first = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    lower = np.column_stack([first, first + 1, first + count + 2])
    upper = np.column_stack([first, first + count + 2, first + count + 1])
    kind = np.add.outer(np.arange(count), np.arange(count)).ravel() % 2
    material = np.where(kind == 0, materials[0], materials[1]).astype(np.int64)
    return Mesh(
        np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]),
        np.concatenate([lower, upper]).astype(np.int64),
        np.tile(material, 2),
    )


def block(half: FloatArray, material: Material) -> Mesh:
    """A block that stands on z = 0."""
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (0, 2)], dtype=np.float64)
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    return Mesh(signs * half, triangles, np.full(12, material, dtype=np.int64))


def standing(name: str, mesh: Mesh) -> Body:
    return Body(name, mesh, lambda _: np.eye(4), static=True)


def driving(name: str, mesh: Mesh) -> Body:
    return Body(name, mesh, lambda time_s: rigid(np.eye(3), np.array([3.0 * time_s, 0.0, 0.0])), static=False)


ROAD = standing("road", squares(1, 200.0, (Material.ROAD, Material.ROAD)))
VAN = driving("van", block(np.array([1.2, 0.9, 0.8]), Material.CLOTH))
MOUNT = looking(np.array([-9.0, 2.0, 5.0]), -0.2, 0.5, 0.05)


@pytest.mark.parametrize("name", LENSES)
def test_a_checker_lands_where_the_lens_projects_it(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tools.scenes.textures.noise", lambda points, *_: np.zeros(len(points)))
    board = standing("board", squares(8, 1.3, (Material.LAMP, Material.GLASS)))
    eye = Eye(LENSES[name], looking(np.array([-5.0, 0.3, 6.0]), 0.03, 0.9, 0.05))
    light = replace(CLEAR, sun=np.zeros(3), sky=np.ones(3))
    image = Renderer([board], eye, light).radiance(0.0) @ np.float32([0.3, 0.6, 0.1])
    width, height = eye.lens.size
    errors = []
    for x in 1.3 * np.arange(-3, 4):
        line = np.column_stack([np.full(800, x), np.linspace(5.2, -5.2, 800), np.zeros(800)])
        edge = project(eye.lens, transform(invert(eye.T_world_camera), line))
        corners = edge[:: 800 // 8, 0]
        for u in range(10, width - 10):
            v = float(np.interp(u, *edge.T, left=0.0, right=0.0))
            if 8 < v < height - 9 and np.abs(corners - u).min() > 6:
                rows = round(v) + np.arange(-6, 7)
                upper, lower = image[rows[:2], u].mean(), image[rows[-2:], u].mean()
                # As many rows as the upper square covers.
                found = rows[0] - 0.5 + ((image[rows, u] - lower) / (upper - lower)).sum()
                errors.append(found - v)
    assert len(errors) > 300
    assert np.quantile(np.abs(errors), 0.9) < 0.05
    assert abs(np.median(errors)) < 0.01


@pytest.mark.parametrize("seed", range(8))
def test_rays_are_the_inverse_of_opencvs_projection(seed: int) -> None:
    rng = np.random.default_rng(seed)
    drawn = random_rig(rng)
    for camera in (drawn.left, drawn.right):
        pixels = rng.uniform([0.0, 0.0], np.array(camera.size) - 1.0, (200, 2))
        directions = rays(camera, pixels)
        assert np.linalg.norm(directions, axis=1) == pytest.approx(1.0)
        back = cv2.projectPoints(directions * 20.0, np.zeros(3), np.zeros(3), camera.K, camera.distortion)[0]
        assert np.abs(back.reshape(-1, 2) - pixels).max() < 0.05


@pytest.mark.parametrize("seed", range(4))
def test_a_rig_survives_its_file(seed: int, tmp_path: Path) -> None:
    drawn = random_rig(np.random.default_rng(seed))
    write_calibration(tmp_path / "stereo.yaml", drawn)
    read = read_stereo_calibration(tmp_path / "stereo.yaml", drawn.left.size)
    for one, other in ((read.left, drawn.left), (read.right, drawn.right)):
        assert one.size == other.size
        np.testing.assert_allclose(one.K, other.K, rtol=1e-12)
        np.testing.assert_allclose(one.distortion, other.distortion, rtol=1e-12)
    np.testing.assert_allclose(read.R_right_left, drawn.R_right_left, atol=1e-12)
    np.testing.assert_allclose(read.t_right_left_m, drawn.t_right_left_m, atol=1e-12)


@pytest.mark.parametrize("turned_deg", [(0.2, 0.1, -0.3), (-0.1, -0.2, 0.1)])
def test_a_camera_that_has_turned_since(turned_deg: tuple[float, float, float]) -> None:
    """Disparities by a stale calibration are off by what the fast simulation adds to them, near the middle."""
    camera = replace(stereo_camera("stereo_05"), turned_deg=turned_deg)
    told = mistold(camera.rig, 0.0, 0.0, turned_deg)
    ahead = np.array([[0.05, 0.02, 1.0], [-0.05, -0.02, 1.0]]) * 20.0
    left_R, right_R, left_P, right_P = bouguet(told)
    in_right = transform(rigid(camera.rig.R_right_left, camera.rig.t_right_left_m), ahead)
    left = undistorted(told.left, project(camera.rig.left, ahead), left_R, left_P)
    right = undistorted(told.right, project(camera.rig.right, in_right), right_R, right_P)
    off_px = (left - right)[:, 0] - camera.focal_px * camera.baseline_m / ahead[:, 2]
    assert np.mean(off_px) == pytest.approx(camera.turned_px, rel=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_a_mounted_camera_looks_down_at_about_its_target(seed: int) -> None:
    rng = np.random.default_rng(seed)
    target = rng.uniform(-20.0, 20.0, 2)
    T = random_mount(rng, target, 20.0)
    assert 3.0 <= T[2, 3] <= 15.0
    assert np.linalg.norm(T[:2, 3] - target) == pytest.approx(20.0)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    towards = np.array([*target, 0.0]) - T[:3, 3]
    assert np.degrees(np.arccos(T[:3, 2] @ towards / np.linalg.norm(towards))) < 15.0
    assert T[2, 1] < 0.0  # the image's down is the world's


@pytest.mark.parametrize("rig", [rig(LENSES["ideal"], LENSES["ideal"]), ASKEW], ids=["ideal", "askew"])
def test_matching_a_rendered_plane_gives_its_disparity(rig: StereoRig, tmp_path: Path) -> None:
    look = Look(CLEAR, replace(GREY, right_gain=1.0))
    write_stereo([ROAD], rig, MOUNT, np.zeros(1), [10**18], tmp_path, look, 1)
    ((_, plane, _, values, sigma),) = matched_frames(tmp_path, np.array([0]))
    truth = exact_truth(RayCaster([ROAD]), plane, MOUNT, 0.0)
    where = truth.shared & plane.left.inner & (np.nan_to_num(truth.disparity) > 4)
    errors = errors_in(values, sigma, truth.disparity, where)
    assert errors.open_ < 0.2 * errors.count
    assert abs(np.median(errors.error)) < 0.02
    assert np.median(np.abs(errors.error)) < 0.1


def test_only_what_is_touched_changes() -> None:
    eye = eyes(ASKEW, MOUNT)[0]
    parts = Renderer([ROAD, VAN], eye, CLEAR)
    touched = parts.touched(0.5)
    # The same van, but everything is rendered anew.
    whole = Renderer([ROAD, VAN], eye, CLEAR)
    whole.background = parts.background
    whole.touched = lambda _: np.ones_like(touched)  # type: ignore[method-assign]
    expected, found = whole.radiance(0.5), parts.radiance(0.5)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)
    changed = np.abs(expected - parts.radiance(1e3)).max(axis=2) > 0.01
    assert 0.02 < changed.mean() < touched.mean() < 0.9


@pytest.mark.slow
@pytest.mark.parametrize("light", [CLEAR, replace(CLEAR, sun=np.zeros(3), sky=np.ones(3))], ids=["sun", "clouds"])
def test_what_stands_is_darkened_as_if_it_were_rendered_anew(light: Light) -> None:
    eye = eyes(ASKEW, MOUNT)[0]
    darkened, anew = Renderer([ROAD, VAN], eye, light), Renderer([ROAD, VAN], eye, light)
    anew._glossy = np.ones(anew.background.key.size, dtype=bool)  # what is glossy is rendered anew
    found, expected = darkened.radiance(0.5), anew.radiance(0.5)
    assert (np.abs(expected - darkened.background.radiance).max(axis=2) > 0.02 * expected.max(axis=2)).mean() > 0.1
    apart = np.abs(found - expected).max(axis=2) / expected.max(axis=2)
    # Between what is rendered anew and what is not there is an edge, over which the lens blurs.
    inner = cv2.morphologyEx(darkened.touched(0.5).astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((7, 7), np.uint8)) == 0
    assert inner.mean() > 0.8
    assert apart[inner].max() < 0.005


def test_the_sun_casts_the_shadow_away_from_it() -> None:
    eye = Eye(LENSES["ideal"], looking(np.array([0.0, 0.0, 14.0]), 0.0, np.pi / 2 - 1e-3))
    light = replace(CLEAR, to_sun=sun_at(90.0, 45.0))
    lit = Renderer([ROAD], eye, light).radiance(0.0).mean(axis=2)
    with_van = Renderer([ROAD, VAN], eye, light).radiance(0.0).mean(axis=2)
    # As high as the van is its shadow long; the sun stands in the world's +y.
    points = np.array([[0.0, -0.9 - y, 0.0] for y in (0.5, 1.1)] + [[0.0, 0.9 + y, 0.0] for y in (0.5, 1.1)])
    u, v = np.rint(project(eye.lens, transform(invert(eye.T_world_camera), points))).astype(int).T
    share = with_van[v, u] / lit[v, u]
    assert (share[:2] < 0.5).all()
    assert (share[2:] > 0.8).all()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_images() -> None:
    tiny = lens(FIVE, size=(120, 90))
    pair = rig(tiny, tiny)
    times = np.array([0.4])

    def images(seed: int, sensor: Sensor) -> FloatArray:
        pairs = stereo_pairs([ROAD, VAN], pair, MOUNT, times, Look(CLEAR, sensor), seed)
        return np.array([image for both in pairs for image in both])

    first = images(3, GREY)
    np.testing.assert_array_equal(first, images(3, GREY))
    assert (first != images(4, GREY)).mean() > 0.1
    deep = images(3, Sensor(bits=16, colour=True))
    assert deep.dtype == np.uint16
    assert deep.shape == (2, 90, 120, 3)


def test_noise_is_the_photons_and_the_amplifiers() -> None:
    flat = lens(size=(400, 300))
    sensor = Sensor(vignetting=0.0, gamma=1.0, bits=16, colour=False, full_well_e=10_000.0, read_noise_e=20.0)
    for share in (0.05, 0.3, 0.7):
        light = np.full((300, 400, 3), share, dtype=np.float32)
        electrons = develop(light, flat, sensor, 1.0, np.random.default_rng(0)) / 65520.0 * 1e4
        assert electrons.mean() == pytest.approx(1e4 * share, rel=0.002)
        # The sample variance of 120,000 pixels is good to 0.4 %.
        rounding = (1e4 / 4095) ** 2 / 12
        assert electrons.var() == pytest.approx(1e4 * share + 400.0 + rounding, rel=0.02)


def test_a_texture_seen_from_afar_is_the_mean_of_what_it_is_nearby() -> None:
    rng = np.random.default_rng(0)
    waves = {0.05: 1.0, 0.2: 1.0}
    width = 0.06
    points = rng.uniform(-5.0, 5.0, (200, 3))
    spread = rng.normal(0.0, BLUR * width, (2000, 3))
    near = noise((points[:, None] + spread).reshape(-1, 3), np.zeros(200 * 2000), waves, 5).reshape(200, -1)
    afar = noise(points, np.full(200, width), waves, 5)
    unfiltered = noise(points, np.zeros(200), waves, 5)
    assert np.std(near.mean(axis=1) - afar) < 0.1 * np.std(unfiltered)
    assert np.std(afar) < 0.9 * np.std(unfiltered)


def test_left_and_right_eye_stand_as_the_rig_says() -> None:
    turned: StereoRig = ASKEW
    left, right = eyes(turned, MOUNT)
    points_left = np.random.default_rng(0).uniform([-3.0, -3.0, 9.0], [3.0, 3.0, 15.0], (20, 3))
    in_right = transform(invert(right.T_world_camera), transform(left.T_world_camera, points_left))
    np.testing.assert_allclose(in_right, points_left @ turned.R_right_left.T + turned.t_right_left_m, atol=1e-9)
    assert Rotation.from_matrix(right.T_world_camera[:3, :3].T @ MOUNT[:3, :3]).magnitude() > 0.01
