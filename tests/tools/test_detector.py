import numpy as np
import pytest

pytest.importorskip("embreex")

from laci_stereo.core.detections import observe_detections
from laci_stereo.core.frames import invert, transform
from tools.scenes.detector import DetectorFlaws, detect
from tools.scenes.scene import draw_scene

EXACT = DetectorFlaws(0.0, 0.0, 0.0, 0.0, 0.0)
FLAT = {"uneven": 0.0, "density": 0.0, "parked": 0, "walkers": 0, "cyclists": 0}


@pytest.mark.parametrize("hanging", ["x forward", "upside down", "y forward"])
def test_exact_boxes_lie_on_the_vehicles(hanging):
    scene = draw_scene(3, "lidar_32", hanging=hanging, drive="left_turn", vehicle="saloon", vehicles=0, **FLAT)
    log = detect(scene, EXACT)
    seen = observe_detections(log, scene.axes)
    track = seen.tracks[0]
    assert len(track.sightings) >= 40
    T_world_level = scene.T_world_sensor @ invert(seen.T_level_sensor)
    times = (log.span_ns[0] - scene.stamps_ns[0]) / 1e9 + scene.times_s[0]
    xy, yaw = scene.sender.track(times + np.array([sighting.stamp_s for sighting in track.sightings]))
    middles = np.array([[*sighting.middle, 0.0] for sighting in track.sightings])
    # Wheels on a plane: nothing but the ground's own fit is between the two.
    np.testing.assert_allclose(transform(T_world_level, middles)[:, :2], xy, atol=0.02)
    found = np.array([sighting.box.yaw_rad for sighting in track.sightings])
    turned = np.arctan2(T_world_level[1, 0], T_world_level[0, 0])
    np.testing.assert_allclose(np.sin(found + turned - yaw), 0.0, atol=5e-3)
    sizes = {(sighting.box.length_m, sighting.box.width_m) for sighting in track.sightings}
    assert sizes == {(scene.vehicle.length_m, scene.vehicle.width_m)}


def test_boxes_miss_and_scatter_as_stated():
    scene = draw_scene(3, "lidar_32", drive="left_turn", vehicles=3, **FLAT)
    exact, flawed = detect(scene, EXACT), detect(scene)
    n = len(exact)
    assert n > 200
    assert len(flawed) == pytest.approx(0.8 * n, abs=5 * np.sqrt(0.16 * n))
    some = detect(scene, DetectorFlaws(position_m=0.1, yaw_deg=0.0, size_m=0.0, missing=0.0, size_share=0.0))
    apart = some.points_sensor - exact.points_sensor
    assert apart.std() == pytest.approx(0.1, rel=5 / np.sqrt(6 * n))
    np.testing.assert_array_equal(some.stamps_ns, exact.stamps_ns)
    assert (np.diff(flawed.stamps_ns) >= 0).all()
