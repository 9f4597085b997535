"""Every reader of the project, called with the contents of a folder."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from laci_lidar.read import read_scan
from laci_lidar.scans import open_scans

from laci_stereo.core.world import World
from laci_stereo.io.cam.log import read_cam_log
from laci_stereo.io.detections import read_detections
from laci_stereo.io.images import ImageFolder, pair_images, read_image
from laci_stereo.io.maps.lane_map import read_lane_map
from laci_stereo.io.result.evidence_file import read_evidence
from laci_stereo.io.result.imported import ImportOptions, import_pose
from laci_stereo.io.result.stored_calibration import read_calibration
from laci_stereo.io.rig.stereo_calibration import read_stereo_calibration
from laci_stereo.mask.contract import read_contract
from laci_stereo.mask.model_file import check_model
from tools.fuzz.worker import Readers

WORLD = World.around(48.4226, 9.9434)
SENT = ImportOptions(kind="stereo", crs="EPSG:32632")
LOCAL = ImportOptions(kind="lidar", crs="EPSG:32632", origin=(569000.0, 5363000.0))


def _only(read: Callable[[Path], object], folder: Path) -> object:
    """Read the only file in a folder."""
    (path,) = folder.iterdir()
    return read(path)


def _read_rig(folder: Path) -> object:
    return read_stereo_calibration(sorted(folder.iterdir()), (400, 300), Path("left"))


def _read_calibration(path: Path) -> object:
    return read_calibration(path).T_utm_sensor


def _read_pose(folder: Path) -> object:
    inside = sorted(folder.iterdir())
    return import_pose(inside[0] if len(inside) == 1 else folder, SENT)


def _read_scans(path: Path) -> object:
    scans = open_scans(path)
    return list(scans.read(range(len(scans)), 1))


def _read_pairs(folder: Path) -> object:
    return pair_images(ImageFolder.open(folder / "left"), ImageFolder.open(folder / "right"))


READERS: Readers = {
    "cam": partial(_only, read_cam_log),
    "rig": _read_rig,
    "map": partial(_only, partial(read_lane_map, to_world=WORLD)),
    "detections": partial(_only, read_detections),
    "calibration": partial(_only, _read_calibration),
    "pose": _read_pose,
    "local pose": partial(_only, partial(import_pose, options=LOCAL)),
    "evidence": partial(_only, read_evidence),
    "contract": partial(_only, read_contract),
    "model": partial(_only, check_model),
    "scan": partial(_only, partial(read_scan, stamp_ns=1_760_000_000_000_000_000)),
    "scans": partial(_only, _read_scans),
    "image": partial(_only, read_image),
    "pairs": _read_pairs,
}
