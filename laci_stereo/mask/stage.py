"""The mask as a stage between the background test and the core: frames in, masked clouds and statistics out."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice

import cv2
import numpy as np

from laci_stereo.core.cloud import PointCloud, empty_cloud
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from laci_stereo.mask.apply import Chosen, Moving, choose
from laci_stereo.mask.detect import Finder, NetworkFinder, Vehicle, covers_all
from laci_stereo.mask.errors import MaskError
from laci_stereo.mask.network import ALL_SHARE, MaskOptions, Network
from laci_stereo.mask.picture import Crop

log = logging.getLogger(__name__)

MOST_WAITING = 64
"""Largest number of frames that wait for the network, nearly all of them empty: memory stays flat."""

DRAWN = 200
"""Largest number of kept points, and of dropped points, that are stored of each frame for the report."""

OUTLINE_PX = 1.0
"""Largest deviation of a drawn outline, pixels."""

FEW_FRAMES = 5
"""Least number of frames or crops for which a fraction of them is meaningful."""


@dataclass(frozen=True)
class Glimpse:
    """The mask's effect on a frame, for a picture; in pixels of the rectified left image.

    Attributes
    ----------
    outlines : tuple of ndarray, shape (n, 2)
        Outlines of boxes or masks.
    kept, dropped : ndarray of int, shape (n, 2)
        Samples of the kept and of the dropped points.
    """

    outlines: tuple[FloatArray, ...]
    kept: IntArray
    dropped: IntArray

    def as_rays(self, rays_at: Callable[[IntArray, IntArray], FloatArray], size: tuple[int, int]) -> GlimpseRays:
        """Convert the pixels, or the next ones in an image of this size, to rays, given those at rows and columns."""

        def of(pixels: FloatArray | IntArray) -> FloatArray:
            u, v = np.rint(pixels).astype(np.int64).reshape(-1, 2).T
            return rays_at(v.clip(0, size[1] - 1), u.clip(0, size[0] - 1))

        return GlimpseRays(tuple(map(of, self.outlines)), of(self.kept), of(self.dropped))


@dataclass(frozen=True)
class GlimpseRays:
    """A `Glimpse` as rays from the left camera, sensor frame, shape (n, 3), with unit depth in the rectified frame."""

    outlines: tuple[FloatArray, ...] = ()
    kept: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    dropped: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))


@dataclass
class Tally:
    """Statistics of a mask's effect on a recording.

    Attributes
    ----------
    name : str
        Name of the network's file.
    assumed : str
        What was assumed in the absence of a contract, as text.
    frames : int
        Number of frames in which something moved.
    fallback : int
        Number of these frames in which the mask found nothing that moves: all points of the background test were kept.
    kept, dropped : int
        Numbers of points.
    vehicles : int
        Number of boxes or masks in which something moved.
    at_rest : int
        Number of boxes or masks in which nothing moved.
    unmasked : int
        Number of changes without a vehicle, in frames with one elsewhere: their points were dropped.
    grown : int
        Number of boxes or masks that cut through a moving surface, which was then kept as a whole.
    filled : int
        Number of crops that the mask filled as a whole.
    crops, runs : int
        Number of crops that the network processed, and number of its runs.
    seconds : float
        Total duration of these runs.
    glimpses : dict of int to Glimpse
        By stamp, nanoseconds.
    """

    name: str = ""
    assumed: str = ""
    frames: int = 0
    fallback: int = 0
    kept: int = 0
    dropped: int = 0
    vehicles: int = 0
    at_rest: int = 0
    unmasked: int = 0
    grown: int = 0
    filled: int = 0
    crops: int = 0
    runs: int = 0
    seconds: float = 0.0
    glimpses: dict[int, Glimpse] = field(default_factory=dict)

    @property
    def warning(self) -> str | None:
        """What is wrong with the mask as a whole, in one line; None if nothing is."""
        if self.frames >= FEW_FRAMES and 2 * self.fallback > self.frames:
            return (
                f"{self.name}: the vehicle mask found nothing that moves in {self.fallback} of {self.frames} frames; "
                "likely reasons: the order of the colours (RGB or BGR), the scale (0 to 255 or 0 to 1), or the class "
                "ids of vehicles in its contract; 'laci-stereo mask' shows what it sees"
            )
        return None

    def sentences(self) -> tuple[str, ...]:
        """Return the mask's effect, and its disagreements with the background test, as sentences."""
        points = self.kept + self.dropped
        share, each_ms = self.dropped / max(points, 1), 1000 * self.seconds / max(self.runs, 1)
        facts = [
            f"of {points} moving points {self.kept} were kept and {self.dropped} dropped ({share:.0%})",
            f"things move in {self.frames} frames; in {self.fallback} of them it found none, and all points stayed",
            f"it ran {self.runs} times for {self.crops} crops, {each_ms:.0f} ms each time",
        ]
        disagreement = (
            (self.unmasked, "changes are no vehicle's by the mask, and were dropped"),
            (self.at_rest, "vehicles by the mask do not move by the background test"),
            (self.grown, "masks cut through a surface that goes on beyond them, which was kept as a whole"),
        )
        facts += [f"mask and background test disagree: {count} {what}" for count, what in disagreement if count]
        return tuple(filter(None, (*facts, self.warning)))


class VehicleMask:
    """Reduces frames to the points of vehicles.

    Parameters
    ----------
    finder : Finder
    name : str
        Name of the network's file.
    assumed : str
        What was assumed in the absence of a contract, as text.

    Attributes
    ----------
    tally : Tally
        Statistics of the latest pass over a recording.
    """

    def __init__(self, finder: Finder, name: str, assumed: str = "") -> None:
        self.finder = finder
        self._name, self._assumed = name, assumed
        self.tally = Tally(name, assumed)

    @classmethod
    def load(cls, options: MaskOptions) -> VehicleMask:
        """Load a network.

        Raises
        ------
        MaskError
        """
        network = Network(options)
        return cls(NetworkFinder(network), options.model.name, network.assumed)

    def apply(self, frames: Iterable[Moving | int], half_window_px: int) -> Iterator[PointCloud]:
        """Yield the cloud of each frame in order; frames wait until their crops fill an input of the network.

        Parameters
        ----------
        frames : iterable of Moving or int
            The moving points of each frame, or the stamp of a frame in which nothing moves.
        half_window_px : int
            Half of the matcher's window.

        Raises
        ------
        MaskError
            If the network fails, or marks more than half of the crops as a whole.
        """
        self.tally = Tally(self._name, self._assumed)
        waiting: list[Moving | int] = []
        crops = 0
        for frame in frames:
            waiting.append(frame)
            crops += 0 if isinstance(frame, int) else len(frame.crops)
            if crops >= self.finder.slots or len(waiting) >= MOST_WAITING:
                yield from self._batch(waiting, half_window_px)
                waiting, crops = [], 0
        yield from self._batch(waiting, half_window_px)
        self._conclude()

    def _batch(self, frames: list[Moving | int], half_window_px: int) -> Iterator[PointCloud]:
        crops = [crop for frame in frames if not isinstance(frame, int) for crop in frame.crops]
        found = iter(self._find(crops) if crops else [])
        for frame in frames:
            if isinstance(frame, int):
                yield empty_cloud(frame)
            else:
                yield self._thinned(frame, [next(found) for _ in frame.crops], half_window_px)

    def _find(self, crops: list[Crop]) -> list[tuple[Vehicle, ...]]:
        tally = self.tally
        runs, seconds = self.finder.runs, self.finder.seconds
        found = self.finder.find(crops)
        tally.crops += len(crops)
        tally.runs += self.finder.runs - runs
        tally.seconds += self.finder.seconds - seconds
        for crop, vehicles in zip(crops, found, strict=True):
            tally.filled += any(covers_all(vehicle, crop, ALL_SHARE) for vehicle in vehicles)
        return found

    def _thinned(self, moving: Moving, found: list[tuple[Vehicle, ...]], half_window_px: int) -> PointCloud:
        vehicles = [vehicle for each in found for vehicle in each]
        chosen = choose(moving, vehicles, half_window_px)
        tally = self.tally
        tally.frames += 1
        tally.at_rest += chosen.used.count(False)
        tally.vehicles += chosen.used.count(True)
        keep = chosen.keep
        if not any(chosen.used):
            tally.fallback += 1
            keep = np.ones(len(keep), dtype=bool)
        else:
            used = iter(chosen.used)
            tally.unmasked += sum(True not in list(islice(used, len(each))) for each in found)
            tally.grown += chosen.grown
        tally.kept += int(keep.sum())
        tally.dropped += int((~keep).sum())
        tally.glimpses[moving.cloud.stamp_ns] = _glimpse(moving, vehicles, chosen, keep)
        return replace(moving.cloud[keep], others=moving.cloud[~keep])

    def _conclude(self) -> None:
        tally = self.tally
        if tally.crops >= FEW_FRAMES and 2 * tally.filled > tally.crops:
            raise MaskError(
                f"{tally.name}: marks all of {tally.filled} of {tally.crops} crops as a vehicle; needed is a network "
                "that marks vehicles (are vehicle_ids those of vehicles?)"
            )
        if tally.warning is not None:
            log.warning("%s", tally.warning)


def _glimpse(moving: Moving, vehicles: list[Vehicle], chosen: Chosen, keep: BoolArray) -> Glimpse:
    pixels = np.column_stack([moving.u, moving.v])
    some = [each[:: max(1, -(-len(each) // DRAWN))] for each in (pixels[keep], pixels[~keep])]
    shown = [vehicle for vehicle, used in zip(vehicles, chosen.used, strict=True) if used]
    return Glimpse(tuple(outline for vehicle in shown for outline in outlines(vehicle)), some[0], some[1])


def outlines(vehicle: Vehicle) -> list[FloatArray]:
    """Return the outline of a vehicle's box, or of each part of its mask, shape (n, 2), pixels of the image."""
    if vehicle.mask is None:
        x0, y0, x1, y1 = vehicle.box.tolist()
        return [np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])]
    parts, _ = cv2.findContours(vehicle.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    simple = (cv2.approxPolyDP(part, OUTLINE_PX, closed=True).reshape(-1, 2) for part in parts)
    return [part.astype(np.float64) + np.array(vehicle.corner) for part in simple if len(part) > 2]
