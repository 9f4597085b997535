"""From the evidence of several results to one result: what ``laci-stereo combine`` runs, for Python."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from laci_stereo.core.combine import Combined
from laci_stereo.core.combine import combine as estimate
from laci_stereo.core.errors import CombineError, EvidenceError, OutputError
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.frames import Raster, planar
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import Settings
from laci_stereo.io.maps.lane_map import LaneMap, read_lane_map
from laci_stereo.io.output import EVIDENCE_FILE, RESULT_FILE
from laci_stereo.io.result.calibration_file import Provenance
from laci_stereo.io.result.evidence_file import Kept, read_evidence
from laci_stereo.io.result.stored_calibration import read_calibration
from laci_stereo.io.text_file import listed, read_text
from laci_stereo.job import Result, sha256
from laci_stereo.report.page import Photographs


@dataclass(frozen=True, kw_only=True)
class CombineOptions:
    """Options of the estimate from several drives.

    Attributes
    ----------
    name : str or None
        Name of the sensor; None takes that of the first result.
    lane_map : Path or None
    map_crs : str or None
        The map's coordinate system where its file does not state it; see `read_lane_map`.
    core : Settings
    """

    name: str | None = None
    lane_map: Path | None = None
    map_crs: str | None = None
    core: Settings = field(default_factory=Settings)


@dataclass(frozen=True)
class Origin:
    """Provenance of a result from several drives.

    Attributes
    ----------
    provenance : Provenance
    read : str
        Description of what was read.
    lane_map : LaneMap or None
    skipped : tuple of str
        Drives that were left out, one line each.
    """

    provenance: Provenance
    read: str
    lane_map: LaneMap | None
    skipped: tuple[str, ...]

    def draw(self, _calibration: Calibration) -> Iterator[tuple[str, Raster]]:
        """Draw no images of the sensor's: none are kept."""
        yield from ()

    def photograph(self, _calibration: Calibration) -> Photographs | None:
        """Return no images: they are with the results that were combined."""
        return None

    def remarks(self) -> tuple[str, ...]:
        """Return no remarks on the sensor: they are with the results that were combined."""
        return ()


def combine(runs: Sequence[Path | str], options: CombineOptions | None = None) -> Result:
    """Estimate a sensor's pose from the drives of several results.

    Parameters
    ----------
    runs : sequence of path
        Result folders, or their evidence files; at least one.
    options : CombineOptions

    Raises
    ------
    InputError
        If something cannot be read, or the results are of different sensors.
    CalibrationError
        If the drives do not determine a transform, or contradict one another.
    """
    options = options or CombineOptions()
    if not runs:
        raise EvidenceError("0 results; needed is at least 1 result folder")
    paths = [_evidence_of(Path(run)) for run in runs]
    kept = [read_evidence(path) for path in paths]
    _check_kind(runs, kept)
    failed = [str(run) for run, path, one in zip(runs, paths, kept, strict=True) if _failed(path, one)]
    passages = [passage for run, one in zip(runs, kept, strict=True) for passage in _named(str(run), one)]
    try:
        combined = estimate(passages, options.core)
    except CombineError as error:
        names = list(dict.fromkeys(one.name for one in kept))
        if len(names) == 1:
            raise
        raise CombineError(f"{error}; are these one sensor? They are named {listed(names)}") from error
    world = combined.calibration.world
    lane_map = None if options.lane_map is None else read_lane_map(options.lane_map, world, options.map_crs)
    files = [*paths, *([] if options.lane_map is None else [options.lane_map])]
    provenance = Provenance(
        name=options.name or kept[0].name,
        kind=kept[0].kind,
        frame=kept[0].frame,
        inputs={str(path): sha256(path) for path in files},
        config={**_read_as(paths[0]), **_config(combined, options)},
        notes=(
            *map(str, combined.shares),
            *(f"{run}: by itself, its verdict is fail" for run in failed),
            *(lane_map.notes if lane_map is not None else ()),
        ),
        T_sensor_rectified=kept[0].T_sensor_rectified,
    )
    skipped = tuple(map(str, combined.left_out))
    left_out = len(passages) - len(combined.shares)
    read = f"{_counted(passages, 'drive')} from {_counted(runs, 'result')}, {left_out} left out"
    return Result(combined.calibration, Origin(provenance, read, lane_map, skipped))


def _counted(what: Sequence[object], name: str) -> str:
    return f"{len(what)} {name}" if len(what) == 1 else f"{len(what)} {name}s"


def check_kept(runs: Sequence[Path | str], out: Path) -> None:
    """Check that a result would not replace one of those that it is made from.

    Raises
    ------
    OutputError
    """
    for run in runs:
        folder = Path(run) if Path(run).is_dir() else Path(run).parent
        if out.exists() and folder.exists() and out.samefile(folder):
            raise OutputError(f"{out}: holds {run}, which is to be combined; needed is another --out")


def _evidence_of(run: Path) -> Path:
    """Return the path of a result's evidence file."""
    if not run.exists():
        raise EvidenceError(f"{run} does not exist; needed is a result folder")
    folder = run.parent if run.name == RESULT_FILE else run
    if not folder.is_dir():
        return run
    if not (folder / EVIDENCE_FILE).exists():
        raise EvidenceError(f"{run}: no {EVIDENCE_FILE} is with it; needed is a result that keeps its evidence")
    return folder / EVIDENCE_FILE


def _failed(evidence: Path, kept: Kept) -> bool:
    """Tell whether the result beside its evidence has the verdict "fail"; one that was taken away has none.

    Raises
    ------
    CalibrationFileError, EvidenceError
        If it cannot be read, or the evidence is of another result.
    """
    path = evidence.with_name(RESULT_FILE)
    if not path.is_file():
        return False
    stored, own = read_calibration(path), kept.passages[0]
    T_world_sensor = planar(own.match.yaw_rad, own.match.shift) @ own.ground.T_level_sensor(own.axes)
    if stored.world != own.world or not np.allclose(stored.T_world_sensor, T_world_sensor, rtol=0.0, atol=1e-6):
        raise EvidenceError(f"{path}: places the sensor elsewhere than {EVIDENCE_FILE} beside it; needed is one result")
    return stored.verdict == "fail"


def _read_as(evidence: Path) -> dict[str, object]:
    """Return the settings by which a result's frames were read, if kept: checks and monitors read others by them.

    `_failed` has checked that the result can be read.
    """
    result = evidence.with_name(RESULT_FILE)
    config = json.loads(read_text(result, EvidenceError))["config"] if result.is_file() else {}
    return {name: config[name] for name in ("stereo", "lidar") if name in config}


def _check_kind(runs: Sequence[Path | str], kept: Sequence[Kept]) -> None:
    for run, one in zip(runs, kept, strict=True):
        if one.kind != kept[0].kind:
            raise EvidenceError(f"{run}: the sensor's kind is {one.kind}; needed is {kept[0].kind} as in {runs[0]}")
        if one.frame != kept[0].frame:
            raise EvidenceError(
                f"{run}: the sensor's frame is {one.frame!r}; needed is {kept[0].frame!r} as in {runs[0]}"
            )


def _named(run: str, kept: Kept) -> Iterator[Passage]:
    count = len(kept.passages)
    for number, passage in enumerate(kept.passages, start=1):
        yield replace(passage, name=run if count == 1 else f"{run} (drive {number} of {count})")


def _config(combined: Combined, options: CombineOptions) -> dict[str, object]:
    """Return every effective setting; the prior uncertainties of times are those of the drives."""
    config: dict[str, object] = asdict(options.core)
    drive = combined.calibration.drive
    times = {"clock_sigma_s": drive.clock_sigma_s, "apart_sigma_s": drive.apart_sigma_s}
    return {**config, "method": "joint", "joint": {**asdict(options.core.joint), **times}}
