"""Print the errors of the tool's stereo matching on rendered pairs of known disparity, beside the fast simulation's.

Run from the repository's root: ``python -m tools.scenes.compare_disparity --seeds 3 --frames 3``; with ``--crossing
FOLDER`` also for the road of a data set of path-traced images with a ``truth.json``.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, Raster, transform
from laci_stereo.core.robust import NORMAL
from laci_stereo.io.images import ImageFolder
from laci_stereo.io.rig.stereo_calibration import read_stereo_calibration
from laci_stereo.stereo.disparity import Region, match
from laci_stereo.stereo.reader import GreyReader
from laci_stereo.stereo.recording import with_context
from laci_stereo.stereo.rectify import Rectification, rectify
from laci_stereo.stereo.settings import StereoSettings
from tools.scenes.disparity import STEREOS, Mounted, StereoCamera, StereoName, match_frame
from tools.scenes.geometry import Material, RayCaster
from tools.scenes.render import Look, random_look, write_stereo
from tools.scenes.scene import Scene, draw_scene

GROSS_PX = 1.0
"""A larger error is the disparity of another surface: the refinement itself moves by less than a pixel."""

JUMP_PX = 2.0
"""Near and far are distinguishable where the disparity jumps by more than this at the sender's silhouette."""

INNER_PX = 12
"""At this distance from the nearest border no window of the matcher or the refinement extends across it."""

REACH_PX = 16
"""Distance outside of a silhouette within which its disparity is searched for."""

LAGS_PX = 24
ROADWAY_M = 2.0
"""Half the width of the strip along a vehicle's track that is certainly road."""


@dataclass(frozen=True)
class Truth:
    """The content of the rectified left image, each of shape (height, width).

    Attributes
    ----------
    disparity : ndarray
        Pixels; NaN where a ray meets nothing.
    material, body : ndarray of int64
        -1 where a ray meets nothing.
    shared : ndarray of bool
        The right camera sees the same point.
    """

    disparity: FloatArray
    material: IntArray
    body: IntArray
    shared: BoolArray


def exact_truth(caster: RayCaster, plane: Rectification, T_world_sensor: FloatArray, time_s: float) -> Truth:
    """Cast a ray through every pixel of the rectified left image."""
    width, height = plane.size
    depth_one = plane.rays.reshape(-1, 3)
    length = np.linalg.norm(depth_one, axis=1)
    origin = T_world_sensor[:3, 3]
    hits = caster.cast(origin, (depth_one / length[:, None]) @ T_world_sensor[:3, :3].T, time_s)
    met = np.flatnonzero(hits.body >= 0)
    disparity = np.full(len(length), np.nan)
    disparity[met] = plane.focal_px * plane.baseline_m * length[met] / hits.distance_m[met]
    material = np.full(len(length), -1, dtype=np.int64)
    for index in np.unique(hits.body[met]):
        own = hits.body == index
        material[own] = caster.bodies[index].mesh.material[hits.triangle[own]]
    shared = np.zeros(len(length), dtype=bool)
    points = transform(T_world_sensor, depth_one[met] * (hits.distance_m[met] / length[met])[:, None])
    side = -1.0 if plane.mirrored else 1.0
    right = (T_world_sensor @ plane.T_sensor_rectified @ np.array([side * plane.baseline_m, 0.0, 0.0, 1.0]))[:3]
    apart = points - right
    reach = np.linalg.norm(apart, axis=1)
    seen = caster.cast(right, apart / reach[:, None], time_s).distance_m > reach * (1 - 2e-3)
    shared[met] = seen & (np.tile(np.arange(width), height)[met] - disparity[met] >= 0)
    shape = (height, width)
    return Truth(disparity.reshape(shape), material.reshape(shape), hits.body.reshape(shape), shared.reshape(shape))


@dataclass(frozen=True)
class Errors:
    """Errors of matching for the pixels of one kind, accumulated over frames.

    Attributes
    ----------
    error, claimed : ndarray, shape (n,)
        Measured minus true disparity and its claimed standard deviation, pixels, of the matched pixels.
    open_ : int
        Number of pixels without a disparity.
    products : ndarray, shape (lags, 2)
        Sum and number of the products of errors at each distance in columns.
    """

    error: FloatArray
    claimed: FloatArray
    open_: int
    products: FloatArray

    def __add__(self, other: Errors) -> Errors:
        return Errors(
            np.concatenate([self.error, other.error]),
            np.concatenate([self.claimed, other.claimed]),
            self.open_ + other.open_,
            self.products + other.products,
        )

    @property
    def count(self) -> int:
        """Number of pixels."""
        return len(self.error) + self.open_


def errors_in(values: FloatArray, sigma: FloatArray, true: FloatArray, where: BoolArray) -> Errors:
    """Compare measured with true disparity within a mask, each of shape (height, width)."""
    error = values - true
    matched = where & np.isfinite(error)
    good = np.where(matched & (np.abs(error) < GROSS_PX), error, np.nan)
    good -= np.nanmedian(good) if np.isfinite(good).any() else 0.0
    products = np.zeros((LAGS_PX, 2))
    for lag in range(LAGS_PX):
        product = good[:, : good.shape[1] - lag] * good[:, lag:]
        products[lag] = np.nansum(product), np.isfinite(product).sum()
    return Errors(error[matched], sigma[matched], int((where & ~matched).sum()), products)


def described(name: str, rendered: Errors, simulated: Errors) -> str:
    """Return a row of the table: each figure for the rendered pairs and, after a slash, for the simulation."""
    both = [measures(errors) for errors in (rendered, simulated)]
    columns = [
        "-" if one is None and other is None else "/".join("-" if text is None else text for text in (one, other))
        for one, other in zip(*both, strict=True)
    ]
    return f"{name:<22}{rendered.count:>9}" + "".join(
        f"{text:>{width}}" for text, width in zip(columns, WIDTHS, strict=True)
    )


def measures(errors: Errors) -> tuple[str | None, ...]:
    """Return one text for each of `MEASURES`; None where too few pixels are matched."""
    gaps = f"{100 * errors.open_ / errors.count:.1f}"
    good = np.abs(errors.error) < GROSS_PX
    if good.sum() < FEWEST:
        return (gaps, *(None for _ in MEASURES[1:]))
    bias = float(np.median(errors.error[good]))
    apart = np.abs(errors.error[good] - bias)
    low, high = np.quantile(errors.claimed, [0.1, 0.9])
    return (
        gaps,
        f"{100 * np.mean(~good):.2f}",
        f"{bias:.2f}",
        f"{NORMAL * float(np.median(apart)):.3f}",
        f"{np.sqrt(np.mean(apart**2)):.3f}",
        f"{low:.2f}..{high:.2f}",
        f"{NORMAL * float(np.median(apart / errors.claimed[good])):.2f}",
        f"{correlation_length(errors.products):.1f}",
    )


MEASURES = ("gaps %", "gross %", "bias", "sigma", "rms", "claimed", "e/claim", "corr px")
WIDTHS = (13, 12, 12, 13, 13, 23, 11, 12)
HEADER = f"{'':<22}{'pixels':>9}" + "".join(f"{name:>{width}}" for name, width in zip(MEASURES, WIDTHS, strict=True))
FEWEST = 100
"""Number of matched pixels that determines a dispersion to 7 %."""


def correlation_length(products: FloatArray) -> float:
    """Return the distance in columns at which the correlation of errors falls below 1 / e."""
    mean = products[:, 0] / np.maximum(products[:, 1], 1)
    correlation = mean / mean[0] if mean[0] > 0 else np.zeros(len(mean))
    below = np.flatnonzero(correlation < np.exp(-1))
    if not len(below):
        return float(LAGS_PX)
    after = int(below[0])
    step = correlation[after - 1] - correlation[after]
    return float(after - 1 + (correlation[after - 1] - np.exp(-1)) / step)


@dataclass(frozen=True)
class Border:
    """How the outline of a near body is reproduced: counts of pixels, to be divided by the outline's length.

    Attributes
    ----------
    outline : int
        Pixels on the outside that touch the outline.
    grown : int
        Pixels outside that have the near disparity.
    worn : int
        Pixels inside that have the far one.
    open_ : ndarray of int64, shape (REACH_PX, 2)
        Pixels outside without a disparity by their distance to the outline, and all pixels there.
    """

    outline: int
    grown: int
    worn: int
    open_: IntArray

    def __add__(self, other: Border) -> Border:
        return Border(
            self.outline + other.outline, self.grown + other.grown, self.worn + other.worn, self.open_ + other.open_
        )


def border_of(values: FloatArray, truth: Truth, body: int) -> Border:
    """Measure how far a body's disparity extends over the surfaces behind it, where the two differ clearly."""
    inside = truth.body == body
    near: Raster = np.where(inside, truth.disparity, 0.0).astype(np.float32)
    far: Raster = np.where(inside | np.isnan(truth.disparity), np.inf, truth.disparity).astype(np.float32)
    window = np.ones((2 * REACH_PX + 1,) * 2, np.uint8)
    near, far = np.asarray(cv2.dilate(near, window)), np.asarray(cv2.erode(far, window))
    apart = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 5)
    outside = ~inside & (apart <= REACH_PX) & (near - truth.disparity > JUMP_PX) & truth.shared
    # Specular reflections on glass have far disparities too, wherever the outline is.
    within = inside & (truth.disparity - far > JUMP_PX) & (far > 0) & (truth.material != Material.GLASS)
    grown = outside & (np.abs(values - near) < np.abs(values - truth.disparity))
    worn = within & (values < (truth.disparity + far) / 2)
    rings = [outside & (apart > k) & (apart <= k + 1) for k in range(REACH_PX)]
    open_ = np.array([(int((ring & np.isnan(values)).sum()), int(ring.sum())) for ring in rings])
    return Border(int((outside & (apart <= 1)).sum()), int(grown.sum()), int(worn.sum()), open_)


def described_border(name: str, border: Border) -> str:
    """Return a line of text about an outline."""
    length = max(border.outline, 1)
    gaps = " ".join(f"{100 * a / max(n, 1):.0f}" for a, n in border.open_[:12].tolist())
    return (
        f"{name}: outline {border.outline} px, grown by {border.grown / length:.2f} px, worn by "
        f"{border.worn / length:.2f} px; gaps in % at 1, 2, ... px outside: {gaps}"
    )


@dataclass(frozen=True)
class Figures:
    """Errors by kind of surface, and at the sender's outline; ``contrast`` is that of the road.

    ``alike``, shape (2,), has the sums of the products of the road's errors in different frames, and of their squares.
    """

    kinds: tuple[tuple[str, Errors], ...]
    border: Border
    contrast: FloatArray
    alike: FloatArray

    def __add__(self, other: Figures) -> Figures:
        pairs = zip(self.kinds, other.kinds, strict=True)
        return Figures(
            tuple((name, one + two) for (name, one), (_, two) in pairs),
            self.border + other.border,
            np.concatenate([self.contrast, other.contrast]),
            self.alike + other.alike,
        )


def figures(
    values: FloatArray, sigma: FloatArray, truth: Truth, sender: int, left: Raster, before: FloatArray | None
) -> tuple[Figures, FloatArray]:
    """Measure one frame, and return its errors on the road as well; arrays have shape (height, width).

    ``before`` are those of another frame.
    """
    filled = np.nan_to_num(truth.disparity).astype(np.float32)
    jump = cv2.morphologyEx(filled, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > JUMP_PX
    inner = cv2.dilate(jump.astype(np.uint8), np.ones((2 * INNER_PX + 1,) * 2, np.uint8)) == 0
    # Windows are cut off at the image's border.
    inner[:INNER_PX] = inner[-INNER_PX:] = inner[:, :INNER_PX] = inner[:, -INNER_PX:] = False
    of_sender = truth.body == sender
    fair = inner & truth.shared
    kinds = [(kind.name.lower(), fair & ~of_sender & (truth.material == kind)) for kind in Material]
    kinds += [(f"sender {kind.name.lower()}", fair & of_sender & (truth.material == kind)) for kind in SENDER_KINDS]
    kinds.append(("hidden from the right", inner & ~truth.shared & np.isfinite(truth.disparity)))
    kinds.append(("sky", inner & np.isnan(truth.disparity)))
    measured = tuple((name, errors_in(values, sigma, np.nan_to_num(truth.disparity), where)) for name, where in kinds)
    road = fair & (truth.material == Material.ROAD)
    errors = np.where(road & (np.abs(values - truth.disparity) < GROSS_PX), values - truth.disparity, np.nan)
    errors -= np.nanmedian(errors)
    alike = np.zeros(2)
    if before is not None:
        alike[:] = np.nansum(errors * before), np.nansum((errors**2 + before**2) / 2 * np.isfinite(errors * before))
    found = Figures(measured, border_of(values, truth, sender), contrast_of(left)[road][::50], alike)
    return found, errors


SENDER_KINDS = (Material.CAR_PAINT, Material.GLASS, Material.TYRE, Material.METAL)


def contrast_of(image: Raster) -> FloatArray:
    """Return the standard deviation in windows of 11 pixels over the mean."""
    grey = image.astype(np.float64)
    mean = cv2.blur(grey, (11, 11))
    variance = np.maximum(cv2.blur(grey**2, (11, 11)) - mean**2, 0.0)
    contrast: FloatArray = np.sqrt(variance) / np.maximum(mean, 1.0)
    return contrast


def matched_frames(
    folder: Path, indices: IntArray
) -> Iterator[tuple[int, Rectification, Raster, FloatArray, FloatArray]]:
    """Match whole frames of a recording on disk: index, rectification, left image, disparity, standard deviation."""
    rig = read_stereo_calibration(folder / "stereo.yaml")
    plane, reader = rectify(rig), GreyReader(rig)
    left, right = (ImageFolder.open(folder / side).files for side in ("left", "right"))
    width, height = plane.size
    region = Region(0, 0, width, height, 0, min(int(plane.focal_px * plane.baseline_m / 2.5), width // 2))
    for index in indices.tolist():
        raw = reader.read(left[index]), reader.read(right[index])
        assert raw[0] is not None, left[index]
        assert raw[1] is not None, right[index]
        wide = with_context(plane.left, raw[0], region), with_context(plane.right, raw[1], region)
        found = match(*wide, region, StereoSettings())
        yield index, plane, wide[0][:, region.reach :], found.values, found.sigma


def of_scene(scene: Scene, look: Look, frames: int) -> tuple[Figures, Figures]:
    """Return the figures of matching on rendered pairs, and those of the fast simulation, for the same frames."""
    camera = replace(scene.sensor, stride=1) if isinstance(scene.sensor, StereoCamera) else None
    assert camera is not None, scene.sensor_kind
    mounted = Mounted(camera, scene.caster, scene.T_world_sensor)
    # The rig of the rendered pairs is known exactly.
    flaws = replace(scene.stereo_flaws, offset_px=0.0)
    sender = len(scene.bodies) - 1
    # The middle third of a recording, where the sender is near.
    times = scene.times_s[(np.linspace(0.35, 0.65, frames) * (len(scene.times_s) - 1)).astype(np.int64)]
    rendered: list[Figures] = []
    simulated: list[Figures] = []
    of_rendered = of_simulated = None
    with tempfile.TemporaryDirectory() as name:
        stamps = [10**18 + round(1e9 * time_s) for time_s in times.tolist()]
        write_stereo(scene.bodies, camera.rig, scene.T_world_sensor, times, stamps, Path(name), look, scene.seed)
        for index, plane, left, values, sigma in matched_frames(Path(name), np.arange(frames)):
            time_s = float(times[index])
            truth = exact_truth(scene.caster, plane, scene.T_world_sensor, time_s)
            one, of_rendered = figures(values, sigma, truth, sender, left, of_rendered)
            fast = match_frame(mounted, flaws, time_s, (scene.seed, index))
            other, of_simulated = figures(fast.disparity_px, fast.sigma_px, truth, sender, left, of_simulated)
            rendered.append(one)
            simulated.append(other)
    return summed(rendered), summed(simulated)


def drawn_look(seed: int, right_gain: float | None) -> Look:
    """Draw light and sensor for a scene."""
    look = random_look(np.random.default_rng(seed))
    return look if right_gain is None else replace(look, sensor=replace(look.sensor, right_gain=right_gain))


def summed(every: list[Figures]) -> Figures:
    """Add up the figures of frames."""
    total = every[0]
    for one in every[1:]:
        total = total + one
    return total


def road_of_crossing(folder: Path) -> tuple[Errors, FloatArray]:
    """Return the errors on the road of a data set, a plane along the vehicle's track, and the road's contrast."""
    told = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    T_world_sensor = np.array(told["stereo"]["T_world_camera_utm"])
    track = np.array(told["vehicle_centres_utm"])[:, 1:] - T_world_sensor[:2, 3]
    T_world_sensor[:2, 3] = 0.0
    ((_, plane, left, values, sigma),) = matched_frames(folder, np.array([0]))
    directions = plane.rays.reshape(-1, 3) @ T_world_sensor[:3, :3].T
    scale = np.where(directions[:, 2] < -1e-3, -T_world_sensor[2, 3] / np.minimum(directions[:, 2], -1e-3), np.inf)
    disparity = (plane.focal_px * plane.baseline_m / scale).reshape(left.shape)
    near = np.isfinite(scale) & (scale < 60.0)
    ground = directions[near, :2] * scale[near, None]
    road = np.zeros(len(scale), dtype=bool)
    road[near] = np.linalg.norm(ground[:, None] - track[None, ::3], axis=2).min(axis=1) < ROADWAY_M
    where = road.reshape(left.shape)
    return errors_in(values, sigma, disparity, where), contrast_of(left)[where][::50]


def print_figures(rendered: Figures, simulated: Figures) -> None:
    """Print the table."""
    print(HEADER)
    for (name, one), (_, other) in zip(rendered.kinds, simulated.kinds, strict=True):
        if one.count:
            print(described(name, one, other))
    print(described_border("sender, rendered", rendered.border))
    print(described_border("sender, simulated", simulated.border))
    shares = "/".join(f"{100 * each.alike[0] / max(each.alike[1], 1e-9):.0f}" for each in (rendered, simulated))
    print(f"variance of the road's errors that is the same in consecutive frames: {shares} %")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="how many scenes")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--frames", type=int, default=3, help="of each scene")
    parser.add_argument("--sensor", choices=STEREOS, default="stereo_05")
    parser.add_argument("--right-gain", type=float, help="of the right image; else drawn for each scene")
    parser.add_argument("--crossing", type=Path, help="folder of a path-traced data set with truth.json")
    arguments = parser.parse_args()
    sensor: StereoName = arguments.sensor
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    both = [
        of_scene(draw_scene(seed, sensor), drawn_look(seed, arguments.right_gain), arguments.frames) for seed in seeds
    ]
    rendered = summed([one for one, _ in both])
    print("rendered pairs, matched / fast simulation; pixels")
    print_figures(rendered, summed([two for _, two in both]))
    print(f"contrast of the road in windows of 11 px: {100 * np.median(rendered.contrast):.1f} %")
    if arguments.crossing:
        errors, contrast = road_of_crossing(arguments.crossing)
        print(
            f"\n{arguments.crossing}, {HEADER.strip()}\nroad  {errors.count}  {'  '.join(map(str, measures(errors)))}"
        )
        print(f"contrast of the road in windows of 11 px: {100 * np.median(contrast):.1f} %")


if __name__ == "__main__":
    main()
