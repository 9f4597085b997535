"""A scene as the tool observes it: by the fast simulation, in rendered images, or by a detector's boxes."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from laci_stereo.core.calibrate import locate
from laci_stereo.core.detections import observe_detections
from laci_stereo.core.messages.cam import FRONT, VehicleTrack
from laci_stereo.core.messages.stations import Senders, senders_of
from laci_stereo.core.observe import Observation, observe, on_the_road
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import Settings
from laci_stereo.core.world import World
from laci_stereo.io.images import ImageFolder, pair_images
from laci_stereo.io.rig.stereo_calibration import read_stereo_calibration
from laci_stereo.run import Options, prepare
from laci_stereo.stereo.recording import StereoRecording
from laci_stereo.stereo.settings import StereoSettings
from tools.scenes.detector import detect
from tools.scenes.scene import Recorded, Scene
from tools.scenes.write import write_cams, write_images

Way = Literal["simulated", "rendered", "detections"]


class Seen(Protocol):
    """All inputs of a calibration; the same ones serve several methods."""

    def locate(self, settings: Settings) -> Calibration:
        """Calibrate."""


@dataclass(frozen=True)
class Observed:
    """What was observed, and the senders' tracks (implements `Seen`).

    Attributes
    ----------
    observation : Observation
    vehicles : mapping of int to VehicleTrack
    world : World
    """

    observation: Observation
    vehicles: Mapping[int, VehicleTrack]
    world: World

    def locate(self, settings: Settings) -> Calibration:
        """Calibrate."""
        return locate(self.observation, self.vehicles, self.world, settings)


@dataclass(frozen=True)
class Filmed:
    """Images and messages as files, calibrated like a user's (implements `Seen`).

    Attributes
    ----------
    folder : TemporaryDirectory
        As `tools.scenes.write` fills it, without a map.
    crs : str
    """

    folder: tempfile.TemporaryDirectory[str]
    crs: str

    def locate(self, settings: Settings) -> Calibration:
        """Calibrate, including the correction of the stereo calibration from the images."""
        folder = Path(self.folder.name)
        options = Options(camera=StereoSettings(workers=1), crs=self.crs, core=settings)
        return prepare(folder / "left", folder / "right", folder / "cam.csv", options).run().calibration


def see(scene: Scene, way: Way, settings: Settings | None = None) -> Seen:
    """Observe a scene, and place the senders' tracks in the world.

    Raises
    ------
    CalibrationError, InputError
        As `calibrate` does.
    """
    settings = settings or Settings()
    if way == "detections":
        log = detect(scene)
        senders = _senders(scene, log.span_ns, settings)
        return Observed(observe_detections(log, scene.axes, settings), senders.vehicles, senders.world)
    if way == "rendered":
        folder = tempfile.TemporaryDirectory()
        write_images(scene, Path(folder.name))
        write_cams(scene.messages, Path(folder.name) / "cam.csv")
        return Filmed(folder, scene.crs)
    source = Recorded(scene)
    senders = _senders(scene, source.span_ns, settings)
    seen = on_the_road(observe(source, settings, None, senders.vehicles), source, senders.vehicles, settings)
    return Observed(seen, senders.vehicles, senders.world)


def _senders(scene: Scene, span_ns: tuple[int, int], settings: Settings) -> Senders:
    return senders_of(scene.messages, span_ns, FRONT, scene.crs, settings.match.clock_sigma_s)


def reopened(folder: Path) -> StereoRecording:
    """Open a stereo camera's images and calibration as `tools.scenes.write` writes them."""
    rig = read_stereo_calibration(folder / "stereo.yaml")
    pairs = pair_images(ImageFolder.open(folder / "left"), ImageFolder.open(folder / "right"))
    return StereoRecording(pairs.pairs, rig, StereoSettings(workers=1))
