"""Calibrate random scenes without a vehicle mask, with a correct one and with wrong ones, side by side.

usage: python -m tools.bench_mask [--sensor stereo_05] [--scenes 30] [--first SEED] [--jobs 2]
       [--rendered [--images DIR]] [--set FACTOR=VALUE ...] [--out FILE.csv [--resume]]

By default matching is simulated; each scene has two other vehicles and three walkers, and twice as many trees and
hedges as usual. With --rendered, images of 768 x 432 pixels are rendered at 3.3 Hz and matched by the tool itself,
once for all masks (one or two minutes per scene on one core). The vehicles and walkers then come within 2 m of the
sender, three shrubs at the kerbs along its path sway in gusts of wind, and trees are static. --set overrides any of
this.

No real network recognises rendered vehicles, so the detector is derived from the ground truth: the boxes of all
vehicles in view, each side with an error of 3 % (one standard deviation), or the visible part of each vehicle at the
resolution of a network with 160 x 160 cells, displaced by a cell, and at random a cell too large or too small. The
wrong masks are boxes with each error by itself and then with all together: shifted by 20 px in a random direction;
every third frame missing; a false box in every crop. A result is *accepted* when it is calibrated with another verdict
than "fail".
"""

from __future__ import annotations

import argparse
import csv
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.cloud import PointCloud, empty_cloud
from laci_stereo.core.errors import CalibrationError
from laci_stereo.core.frames import Axes, BoolArray, FloatArray, IntArray, Raster, invert, transform
from laci_stereo.mask.apply import Moving, windows
from laci_stereo.mask.detect import Finder, Vehicle
from laci_stereo.mask.picture import Crop
from laci_stereo.mask.stage import VehicleMask
from laci_stereo.stereo.recording import StereoRecording
from laci_stereo.stereo.rectify import Rectification
from laci_stereo.stereo.settings import StereoSettings
from tools.scenes.__main__ import settings as read_factors
from tools.scenes.disparity import STEREOS, StereoCamera, reproject
from tools.scenes.geometry import RayCaster
from tools.scenes.runs import NO_SCENE
from tools.scenes.scene import SENSORS, Recorded, Scene, SceneError, draw_scene, errors_of
from tools.scenes.seeing import reopened
from tools.scenes.traffic import Mover
from tools.scenes.write import write_images

FACTORS: dict[str, object] = {"walkers": 3, "vehicles": 2, "density": 2.0}
CLOSE: dict[str, object] = {"walkers": 3, "vehicles": 2, "near_m": 2.0, "shrubs": 3}
RENDERED_SHARE, RENDERED_STEP = 0.6, 3
"""Scale of the rendered images' size, and the step between rendered frames."""

LEAST_LENGTH_M = 2.5
"""A shorter mover is a walker or a cyclist."""

SIDE_SIGMA = 0.03
SHIFT_PX = 20.0
EDGE_STEPS, NEAREST_M = 20, 0.5
"""Points on each edge of a mesh, and the least distance in front of the camera at which they are visible."""

SLOTS, LEAST_PX = 6, 160

OUTLINES = "outlines"
CELLS, CELL_SIGMA, LEAST_CELLS = 160, 0.7, 12
"""For an outline: number of cells along the longer side of a crop, standard deviation of its displacement in each
direction, in cells, and least number of cells."""

ERRORS = ("track_xy_cm", "rotation_deg", "sigma_ratio", "rotation_ratio")

Boxes = FloatArray
"""Left, top, right and bottom in the rectified left image, shape (n, 4)."""


@dataclass(frozen=True)
class Glance:
    """The inputs of a detector error: frame number, crop, direction of the scene's shift (pixels), random numbers."""

    frame: int
    crop: Crop
    shift: FloatArray
    rng: np.random.Generator


Spoil = Callable[[Boxes, Glance], Boxes]
Shown = Callable[[int, IntArray, IntArray], IntArray]
"""Returns the body that each pixel of an image shows, shape (n,), from its stamp and the pixels' columns and rows."""


def right(boxes: Boxes, _glance: Glance) -> Boxes:
    """Return the boxes unchanged."""
    return boxes


def shifted(boxes: Boxes, glance: Glance) -> Boxes:
    """Shift all boxes, in the same direction throughout a scene."""
    return boxes + np.tile(glance.shift, 2)


def missing(boxes: Boxes, glance: Glance) -> Boxes:
    """Leave out the boxes of every third frame."""
    return boxes[:0] if glance.frame % 3 == 0 else boxes


def false(boxes: Boxes, glance: Glance) -> Boxes:
    """Add a box of half of the crop's size at a random place within it."""
    size = np.array(glance.crop.size)
    corner = np.array([glance.crop.x0, glance.crop.y0]) + glance.rng.uniform(0.0, 0.5, 2) * size
    return np.vstack([boxes, np.concatenate([corner, corner + size / 2])])


def everything(boxes: Boxes, glance: Glance) -> Boxes:
    """Apply all of these errors."""
    return missing(false(shifted(boxes, glance), glance), glance)


MASKS: dict[str, Spoil | None] = {
    "without": None,
    "with": right,
    OUTLINES: right,
    "shifted": shifted,
    "third missing": missing,
    "false boxes": false,
    "all wrong": everything,
}


class TrueDetector:
    """A detector that finds the true boxes of a scene's vehicles, with the errors of a spoilt one."""

    slots, least_px = SLOTS, LEAST_PX
    runs, seconds = 0, 0.0

    def __init__(self, boxes: dict[int, Boxes], spoil: Spoil, seed: int, stride: int) -> None:
        self._boxes = boxes
        self._number = {stamp: number for number, stamp in enumerate(sorted(boxes))}
        self._spoil = spoil
        self._rng = np.random.default_rng(seed)
        angle = 2 * np.pi * self._rng.random()
        self._shift = SHIFT_PX / stride * np.array([np.cos(angle), np.sin(angle)])

    def find(self, crops: Sequence[Crop]) -> list[tuple[Vehicle, ...]]:
        """Return the boxes in each crop, cut off at its border."""
        return [self._in(crop) for crop in crops]

    def _in(self, crop: Crop) -> tuple[Vehicle, ...]:
        boxes = self._boxes[crop.stamp_ns]
        sides = np.tile(boxes[:, 2:] - boxes[:, :2], 2)
        boxes = boxes + SIDE_SIGMA * sides * self._rng.normal(size=boxes.shape)
        boxes = self._spoil(boxes, Glance(self._number[crop.stamp_ns], crop, self._shift, self._rng))
        first = np.array([crop.x0, crop.y0])
        middle = (boxes[:, :2] + boxes[:, 2:]) / 2
        inside = ((middle >= first) & (middle < first + crop.size)).all(axis=1)
        cut = boxes[inside].clip(np.tile(first, 2), np.tile(first + crop.size, 2))
        return tuple(Vehicle(box, 1.0, 2) for box in cut)


class TrueSegmenter:
    """A segmenter that finds the visible parts of a scene's vehicles, coarsely and slightly displaced."""

    slots, least_px = SLOTS, LEAST_PX
    runs, seconds = 0, 0.0

    def __init__(self, scene: Scene, shown: Shown, seed: int) -> None:
        names = [{body.name for body in mover.bodies} for mover in vehicles_in(scene)]
        self._vehicles = [[n for n, body in enumerate(scene.bodies) if body.name in each] for each in names]
        self._shown = shown
        self._rng = np.random.default_rng(seed)

    def find(self, crops: Sequence[Crop]) -> list[tuple[Vehicle, ...]]:
        """Return the outlines in each crop."""
        return [tuple(self._in(crop)) for crop in crops]

    def _in(self, crop: Crop) -> Iterator[Vehicle]:
        cell = max(1.0, max(crop.size) / CELLS)
        u, v = ((np.arange(0.0, side, cell) + cell / 2).astype(int).clip(0, side - 1) for side in crop.size)
        at_u, at_v = (axis.ravel() for axis in np.meshgrid(u + crop.x0, v + crop.y0))
        body = self._shown(crop.stamp_ns, at_u, at_v).reshape(len(v), len(u))
        for own in self._vehicles:
            cells: Raster = np.isin(body, own).astype(np.uint8)
            if int(cells.sum()) < LEAST_CELLS:
                continue
            beside = np.column_stack([np.eye(2), CELL_SIGMA * self._rng.normal(size=2)])
            cells = cv2.warpAffine(cells, beside, (len(u), len(v)))
            change = (cv2.erode, cv2.dilate, None)[self._rng.integers(3)]
            cells = cells if change is None else change(cells, np.ones((3, 3), np.uint8))
            mask = cv2.resize(cells, crop.size, interpolation=cv2.INTER_NEAREST) > 0
            if mask.any():
                x0, y0, width, height = cv2.boundingRect(mask.astype(np.uint8))
                box = np.array([x0, y0, x0 + width, y0 + height], dtype=np.float64)
                yield Vehicle(box + np.tile([crop.x0, crop.y0], 2), 1.0, 2, mask, (crop.x0, crop.y0))


class MatchedOnce:
    """A short stereo recording whose frames are matched once and kept in memory (implements `PointCloudSource`).

    Parameters
    ----------
    recording : StereoRecording
    frames : tuple of Moving or int
        As for `VehicleMask.apply`.
    """

    def __init__(self, recording: StereoRecording, frames: tuple[Moving | int, ...]) -> None:
        self.axes, self.span_ns = recording.axes, recording.span_ns
        self.mask: VehicleMask | None = None
        self._half_window_px = recording.settings.refine_window_px // 2
        self._survey = tuple(recording.survey())
        self._frames = frames

    @classmethod
    def of(cls, recording: StereoRecording) -> MatchedOnce:
        """Match all frames."""
        mask = VehicleMask(TrueDetector({}, right, 0, 1), "")
        return cls(recording, tuple(recording._moving_pixels(recording._scene, mask, pair) for pair in recording.pairs))

    def __len__(self) -> int:
        return len(self._frames)

    def survey(self) -> Iterator[PointCloud]:
        """Yield whole frames."""
        return iter(self._survey)

    def __iter__(self) -> Iterator[PointCloud]:
        if self.mask is not None:
            return self.mask.apply(self._frames, self._half_window_px)
        return (empty_cloud(frame) if isinstance(frame, int) else frame.cloud for frame in self._frames)


class Simulated:
    """A simulated stereo camera with a mask (implements `PointCloudSource`); its pixels are the simulation's grid."""

    def __init__(self, scene: Scene) -> None:
        camera = scene.sensor
        assert isinstance(camera, StereoCamera), scene.sensor_kind
        self.scene, self.camera = scene, camera
        self.mask: VehicleMask | None = None
        self.axes: Axes = scene.axes
        self._plain = Recorded(scene)

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last stamp."""
        return self._plain.span_ns

    def __len__(self) -> int:
        return len(self._plain)

    def survey(self) -> Iterator[PointCloud]:
        """Yield whole frames."""
        return self._plain.survey()

    def __iter__(self) -> Iterator[PointCloud]:
        if self.mask is None:
            return iter(self._plain)
        half_window = -(-StereoSettings().refine_window_px // 2 // self.camera.stride)
        return self.mask.apply(map(self.moving, range(len(self))), half_window)

    def moving(self, index: int) -> Moving:
        """Return the moving pixels of a frame."""
        stamp_ns, camera = int(self.scene.stamps_ns[index]), self.camera
        matched = self._plain._matched(index)
        cloud = reproject(camera, stamp_ns, matched, matched.moving)
        keep = np.isfinite(matched.disparity_px) & matched.moving
        v, u = np.nonzero(keep)
        # The road is z = 0: a ray that descends by k per metre of depth meets it at a depth of height / k.
        fall = -(camera.rays[keep.ravel()] @ self.scene.T_world_sensor[2, :3])
        road = camera.focal_px * camera.baseline_m * fall / self.scene.T_world_sensor[2, 3]
        above = (matched.disparity_px[keep] - road) / matched.sigma_px[keep]
        stats = cv2.connectedComponentsWithStats(matched.moving.astype(np.uint8))[2][1:, :4]
        rectangles = [(x, y, x + w, y + h) for x, y, w, h in stats.tolist()]
        size = (matched.moving.shape[1], matched.moving.shape[0])
        cut = windows(rectangles, size, LEAST_PX // camera.stride)
        crops = tuple(Crop(stamp_ns, x0, y0, np.zeros((y1 - y0, x1 - x0, 3), np.uint8)) for x0, y0, x1, y1 in cut)
        height_m = self.scene.T_world_sensor[2, 3] * (1.0 - road / matched.disparity_px[keep])
        return Moving(cloud, u, v, above, height_m, crops)

    def is_vehicle(self, index: int) -> BoolArray:
        """Return which pixels of a frame truly show a vehicle, shape (rows, columns)."""
        shown: BoolArray = np.isin(self._plain._matched(index).body, self._numbers())
        return shown

    def boxes_at(self, index: int) -> Boxes:
        """Return the boxes of the visible parts of all vehicles in a frame."""
        body = self._plain._matched(index).body
        found = []
        for number in self._numbers():
            v, u = np.nonzero(body == number)
            if len(u):
                found.append([u.min(), v.min(), u.max() + 1, v.max() + 1])
        return np.array(found, dtype=np.float64).reshape(-1, 4)

    def shown(self, stamp_ns: int, u: IntArray, v: IntArray) -> IntArray:
        """Return the body that each pixel shows; see `Shown`."""
        index = int(np.flatnonzero(self.scene.stamps_ns == stamp_ns)[0])
        body: IntArray = self._plain._matched(index).body[v, u]
        return body

    def true_boxes(self) -> dict[int, Boxes]:
        """Return the boxes of all frames, by stamp."""
        return {stamp_ns: self.boxes_at(index) for index, stamp_ns in enumerate(self.scene.stamps_ns.tolist())}

    def _numbers(self) -> list[int]:
        names = {body.name for mover in vehicles_in(self.scene) for body in mover.bodies}
        return [number for number, body in enumerate(self.scene.bodies) if body.name in names]


def vehicles_in(scene: Scene) -> list[Mover]:
    """Return the movers that are not walkers or cyclists."""
    return [mover for mover in (scene.sender, *scene.others) if mover.length_m >= LEAST_LENGTH_M]


def true_boxes(scene: Scene, recording: StereoRecording, step: int = 1) -> dict[int, Boxes]:
    """Return the boxes of all vehicles in view, by stamp of each ``step``-th frame; occlusion is not considered."""
    found: dict[int, Boxes] = {}
    for stamp_ns, time_s in zip(scene.stamps_ns[::step].tolist(), scene.times_s[::step].tolist(), strict=True):
        each = [_box(mover, time_s, scene, recording.rectification) for mover in vehicles_in(scene)]
        found[stamp_ns] = np.array([box for box in each if box is not None]).reshape(-1, 4)
    return found


def _box(mover: Mover, time_s: float, scene: Scene, plane: Rectification) -> FloatArray | None:
    T_rectified_body = invert(scene.T_world_sensor @ plane.T_sensor_rectified) @ mover.pose(time_s)
    corners = mover.mesh.vertices[mover.mesh.triangles]
    along = np.linspace(0.0, 1.0, EDGE_STEPS, endpoint=False)[:, None, None, None]
    # Sampled edges: of an edge that extends behind the camera, only the part in front of it is visible.
    points = transform(T_rectified_body, (corners + along * (np.roll(corners, 1, axis=1) - corners)).reshape(-1, 3))
    points = points[points[:, 2] > NEAREST_M]
    if not len(points):
        return None
    rays = plane.rays[[0, 0, 1], [0, 1, 0]] @ plane.T_sensor_rectified[:3, :3]
    step = np.array([rays[1, 0] - rays[0, 0], rays[2, 1] - rays[0, 1]])
    pixels = (points[:, :2] / points[:, 2:] - rays[0, :2]) / step
    low, high = (edge.clip(0, plane.size) for edge in (pixels.min(axis=0), pixels.max(axis=0)))
    return None if (high - low).min() < 4 else np.concatenate([low, high])


@dataclass(frozen=True)
class Row:
    """One scene with one mask; NaN where there is no result."""

    seed: int
    mask: str
    refused: str = ""
    track_xy_cm: float = np.nan
    rotation_deg: float = np.nan
    sigma_ratio: float = np.nan
    rotation_ratio: float = np.nan
    kept: int = 0
    dropped: int = 0
    fallback: int = 0
    grown: int = 0


def run(seed: int, sensor: str, factors: dict[str, object], paint: bool, images: Path | None) -> list[Row]:
    """Observe a scene once, and calibrate it with each mask; keep rendered images in ``images`` unless it is None."""
    kind = {name: name for name in SENSORS}[sensor]  # type: ignore[index]
    try:
        scene = draw_scene(seed, kind, **{**(CLOSE if paint else FACTORS), **factors})
    except SceneError as error:
        return [Row(seed, name, f"{NO_SCENE}: {error}") for name in MASKS]
    if not paint:
        source = Simulated(scene)
        truth = Truth(source.true_boxes(), source.shown, source.camera.stride)
        return [_row(Row(seed, name), scene, source, truth) for name in MASKS]
    scene = small_and_calm(scene)
    with tempfile.TemporaryDirectory() as folder:
        recording = painted(scene, Path(folder) if images is None else images / f"{sensor}_{seed}")
        truth = Truth(true_boxes(scene, recording, RENDERED_STEP), partial(_cast, scene, recording), 1)
        try:
            matched = MatchedOnce.of(recording)
        except CalibrationError as error:  # no ground, with whatever mask
            return [Row(seed, name, f"{type(error).__name__}: {error}") for name in MASKS]
        return [_row(Row(seed, name), scene, matched, truth) for name in MASKS]


def painted(scene: Scene, folder: Path) -> StereoRecording:
    """Render a scene, or open the images rendered earlier."""
    last = folder / "right" / f"{scene.stamps_ns[::RENDERED_STEP][-1]}.png"
    if not last.exists():
        write_images(scene, folder, RENDERED_STEP)
    return reopened(folder)


def small_and_calm(scene: Scene) -> Scene:
    """Return a scene with smaller images of the same field of view, in which trees and hedges do not sway.

    They sway permanently by at most a hundredth of their height, which the tool takes for noise, but rendering this
    motion would be most of the work.
    """
    camera = scene.sensor
    assert isinstance(camera, StereoCamera), scene.sensor_kind
    width, height = (round(RENDERED_SHARE * side) for side in camera.size_px)
    camera = replace(camera, size_px=(width, height), focal_px=RENDERED_SHARE * camera.focal_px)
    bodies = tuple(
        replace(body, static=body.static or body.name.startswith(("tree", "hedge"))) for body in scene.site.bodies
    )
    return replace(scene, sensor=camera, site=replace(scene.site, bodies=bodies))


def _cast(scene: Scene, recording: StereoRecording, stamp_ns: int, u: IntArray, v: IntArray) -> IntArray:
    """Return the body that each pixel of a rectified image shows; see `Shown`."""
    rays = recording.rectification.rays[v, u] @ scene.T_world_sensor[:3, :3].T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    time_s = float(scene.times_s[scene.stamps_ns == stamp_ns][0])
    return RayCaster(scene.bodies).cast(scene.T_world_sensor[:3, 3], rays, time_s).body


@dataclass(frozen=True)
class Truth:
    """Ground truth for the detectors: boxes by stamp, the body shown by each pixel, and the pixels' stride."""

    boxes: dict[int, Boxes]
    shown: Shown
    stride: int

    def finder(self, name: str, scene: Scene, seed: int) -> Finder | None:
        """Return the detector of one of `MASKS`."""
        spoil = MASKS[name]
        if spoil is None:
            return None
        if name == OUTLINES:
            return TrueSegmenter(scene, self.shown, seed)
        return TrueDetector(self.boxes, spoil, seed, self.stride)


def _row(row: Row, scene: Scene, source: MatchedOnce | Simulated, truth: Truth) -> Row:
    finder = truth.finder(row.mask, scene, row.seed)
    source.mask = None if finder is None else VehicleMask(finder, row.mask)
    try:
        found = calibrate(source, scene.messages, crs=scene.crs)
    except CalibrationError as error:
        return replace(row, refused=f"{type(error).__name__}: {error}")
    errors = errors_of(found, scene)
    row = replace(
        row,
        refused="verdict fail" if found.quality.verdict == "fail" else "",
        track_xy_cm=errors.track_xy_cm,
        rotation_deg=errors.rotation_deg,
        sigma_ratio=errors.sigma_ratio,
        rotation_ratio=errors.rotation_ratio,
    )
    if source.mask is None:
        return row
    tally = source.mask.tally
    return replace(row, kept=tally.kept, dropped=tally.dropped, fallback=tally.fallback, grown=tally.grown)


def _of(rows: Sequence[Row], key: str) -> FloatArray:
    return np.array([getattr(row, key) for row in rows])


def report(rows: Sequence[Row]) -> str:
    """Return a table with one line for each mask; errors are those of the accepted results.

    The last two columns compare the same scenes: those that are accepted without a mask as well, with their 95th
    percentile without and with the mask.
    """
    names = (
        *("mask", "scenes", "refused", "cm median", "95 %", "worst", "deg 95 %", "over 3 sigma: track, angle"),
        *("worst, sigma", "dropped", "both accept", "95 % of those: cm", "deg"),
    )
    lines = ["| " + " | ".join(names) + " |", "|---" * len(names) + "|"]
    plain = {row.seed: row for row in rows if row.mask == "without" and not row.refused}
    for name in MASKS:
        mine = [row for row in rows if row.mask == name and not row.refused.startswith(NO_SCENE)]
        good = [row for row in mine if not row.refused]
        if not good:
            lines.append(f"| {name} | {len(mine)} | {len(mine)} |" + 10 * " |")
            continue
        cm, deg, by_track, by_angle = (_of(good, key) for key in ERRORS)
        points = sum(row.kept + row.dropped for row in good)
        dropped = sum(row.dropped for row in good) / max(points, 1)
        both = [row for row in good if row.seed in plain]
        pairs = [
            " -> ".join(
                f"{np.quantile(_of(some, key), 0.95):.{digits}f}" for some in ([plain[row.seed] for row in both], both)
            )
            if both
            else ""
            for key, digits in (("track_xy_cm", 1), ("rotation_deg", 2))
        ]
        lines.append(
            f"| {name} | {len(mine)} | {len(mine) - len(good)} | {np.median(cm):.1f} | {np.quantile(cm, 0.95):.1f} "
            f"| {cm.max():.1f} | {np.quantile(deg, 0.95):.2f} | {(by_track > 3).sum()}, {(by_angle > 3).sum()} "
            f"| {by_track.max():.1f}, {by_angle.max():.1f} | {dropped:.0%} | {len(both)} | {pairs[0]} | {pairs[1]} |"
        )
    return "\n".join(lines)


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write the rows so far."""
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, [field.name for field in fields(Row)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


def read_rows(path: Path) -> list[Row]:
    """Read the rows that an earlier run has written."""
    with path.open(newline="") as stream:
        return [_parsed(line) for line in csv.DictReader(stream)]


def _parsed(line: dict[str, str]) -> Row:
    parsers: dict[str, Callable[[str], object]] = {"int": int, "float": float, "str": str}
    return Row(**{each.name: parsers[str(each.type)](line[each.name]) for each in fields(Row)})  # type: ignore[arg-type]


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensor", choices=STEREOS, default="stereo_05")
    parser.add_argument("--scenes", type=int, default=30)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--rendered", action="store_true", help="paint images and match them")
    parser.add_argument("--images", type=Path, help="keep rendered images there, and use those that are there already")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--set", action="append", default=[], metavar="FACTOR=VALUE", help="see tools/scenes/scene.py")
    parser.add_argument("--out", type=Path, help="one line per scene and mask, as CSV")
    parser.add_argument("--resume", action="store_true", help="skip what stands there, of the same factors")
    arguments = parser.parse_args()
    if arguments.resume and arguments.out is None:
        parser.error("--resume needs --out")
    factors = read_factors(arguments.set)
    seeds = range(arguments.first, arguments.first + arguments.scenes)
    rows = read_rows(arguments.out) if arguments.resume and arguments.out.exists() else []
    left = sorted(set(seeds) - {row.seed for row in rows})
    with ProcessPoolExecutor(arguments.jobs) as pool:
        about = arguments.sensor, factors, arguments.rendered, arguments.images
        jobs = [pool.submit(run, seed, *about) for seed in left]
        for number, done in enumerate(as_completed(jobs), start=1):
            rows += done.result()
            print(f"\r{number} of {len(jobs)}", end="", flush=True)
            if arguments.out is not None:
                write_rows(arguments.out, rows)
    print(f"\n{report(rows)}")


if __name__ == "__main__":
    main()
