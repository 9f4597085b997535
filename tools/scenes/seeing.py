"""What the tool sees of a scene: by the fast simulation, in rendered images, or by a detector's boxes."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from laci_stereo.core.calibrate import locate, vehicles_of, world_around
from laci_stereo.core.cam import FRONT, VehicleTrack
from laci_stereo.core.cloud import PointCloudSource
from laci_stereo.core.detections import observe_detections
from laci_stereo.core.observe import Observation, observe, on_the_road
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import Settings
from laci_stereo.core.world import World
from laci_stereo.io.images import ImageFolder, pair_images
from laci_stereo.io.stereo_calibration import read_stereo_calibration
from laci_stereo.stereo.recording import StereoRecording
from laci_stereo.stereo.settings import StereoSettings
from tools.scenes.cameras import mistold, raw_rig
from tools.scenes.detector import detect
from tools.scenes.disparity import StereoCamera
from tools.scenes.render import random_look, write_stereo
from tools.scenes.scene import Recorded, Scene

Way = Literal["simulated", "rendered", "detections"]

RENDERED_STEP = 2
"""Of the frames every second is rendered, 5 per second."""


@dataclass(frozen=True)
class Seen:
    """All that a calibration starts from; one serves several methods.

    Attributes
    ----------
    observation : Observation
    vehicles : dict of int to VehicleTrack
    world : World
    """

    observation: Observation
    vehicles: dict[int, VehicleTrack]
    world: World

    def locate(self, settings: Settings) -> Calibration:
        """Calibrate."""
        return locate(self.observation, self.vehicles, self.world, settings)


def see(scene: Scene, way: Way, settings: Settings | None = None) -> Seen:
    """Observe a scene, and lay out where the senders were.

    Raises
    ------
    CalibrationError, InputError
        As `calibrate` does.
    """
    settings = settings or Settings()
    if way == "detections":
        log = detect(scene)
        vehicles, world = _senders(scene, log.span_ns, settings)
        return Seen(observe_detections(log, scene.axes, settings), vehicles, world)
    if way == "rendered":
        with tempfile.TemporaryDirectory() as folder:
            return _watched(scene, rendered(scene, Path(folder)), settings)
    return _watched(scene, Recorded(scene), settings)


def _watched(scene: Scene, source: PointCloudSource, settings: Settings) -> Seen:
    vehicles, world = _senders(scene, source.span_ns, settings)
    return Seen(on_the_road(observe(source, settings), source, vehicles, settings), vehicles, world)


def _senders(scene: Scene, span_ns: tuple[int, int], settings: Settings) -> tuple[dict[int, VehicleTrack], World]:
    messages = scene.messages.between(*span_ns, settings.match.clock_sigma_s)
    world = world_around(messages, scene.crs)
    return vehicles_of(messages, world, span_ns[0], FRONT), world


def rendered(scene: Scene, folder: Path, step: int = RENDERED_STEP) -> StereoRecording:
    """Render a stereo camera's raw images of every ``step``-th frame into a folder, and open them as a user's."""
    camera, look = _stereo(scene), random_look(np.random.default_rng(scene.seed))
    rig = raw_rig(np.random.default_rng([scene.seed, 8]), camera.size_px, camera.focal_px, camera.baseline_m)
    stamps = scene.stamps_ns[::step].tolist()
    write_stereo(scene.bodies, rig, scene.T_world_sensor, scene.times_s[::step], stamps, folder, look, scene.seed)
    return reopened(scene, folder)


def reopened(scene: Scene, folder: Path) -> StereoRecording:
    """Open images of a stereo camera that were rendered before, with the rig that is written beside them."""
    camera, rig = _stereo(scene), read_stereo_calibration(folder / "stereo.yaml")
    told = mistold(rig, camera.focal_error, camera.baseline_error)
    pairs = pair_images(ImageFolder.open(folder / "left"), ImageFolder.open(folder / "right"))
    return StereoRecording(pairs.pairs, told, StereoSettings(workers=1))


def _stereo(scene: Scene) -> StereoCamera:
    assert isinstance(scene.sensor, StereoCamera), scene.sensor_kind
    return scene.sensor
