"""A scanner over an empty road, and recordings in memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from laci_lidar.errors import ScanError
from laci_lidar.scan import Scan
from laci_lidar.sequence import counted

from laci_stereo.core.frames import FloatArray, IntArray
from tests.lidar.support import EPOCH_NS, PERIOD_NS


def road(
    field_deg: tuple[float, float] = (-60.0, 60.0),
    layers: int = 32,
    step_deg: float = 0.4,
    height_m: float = 5.0,
    tilt_deg: float = 10.0,
    sigma_m: float = 0.0,
    jitter_rad: float = 0.0,
    seed: int = 0,
) -> FloatArray:
    """Return the points that a scanner sees of a flat road, x forward, z up, tilted down."""
    rng = np.random.default_rng(seed)
    azimuth = np.radians(np.arange(field_deg[0], field_deg[1] + 1e-9, step_deg))
    elevation = np.radians(np.linspace(-22.0, 9.0, layers))
    e, a = (grid.ravel() for grid in np.meshgrid(elevation, azimuth, indexing="ij"))
    true_e = e + jitter_rad * rng.normal(size=e.shape)
    directions = np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    true = np.column_stack([np.cos(true_e) * np.cos(a), np.cos(true_e) * np.sin(a), np.sin(true_e)])
    tilt = np.radians(tilt_deg)
    down = np.array([-np.sin(tilt), 0.0, -np.cos(tilt)])
    steepness = true @ -down * -1.0
    seen = steepness > height_m / 100.0
    ranges = height_m / steepness[seen] + sigma_m * rng.normal(size=int(seen.sum()))
    return directions[seen] * ranges[:, None]


@dataclass(frozen=True)
class Listed:
    """Scans in memory (implements `ScanSequence`); None is unreadable."""

    scans: Sequence[Scan | None]
    stamps_ns: IntArray
    path: Path = Path("memory")
    skipped: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.scans)

    def read(self, indices: Sequence[int], threads: int) -> Iterator[Scan | None]:
        results = ((str(i), self.scans[i] or ScanError(f"scan {i} is bad")) for i in indices)
        return counted(results, self.skipped)


def listed(scans: Sequence[Scan | None], gaps: Sequence[int] = ()) -> Listed:
    """Put scans a period apart; after those in ``gaps`` there is one of a second."""
    steps = np.full(len(scans), PERIOD_NS)
    steps[0] = 0
    steps[[gap + 1 for gap in gaps]] = 10 * PERIOD_NS
    return Listed(scans, EPOCH_NS + np.cumsum(steps))
