"""Runs of the benchmark of scenes: the outcome of each, as lines of a file and as a table."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

HONEST_SIGMAS, WRONG_SIGMAS = 3.0, 5.0


@dataclass(frozen=True)
class Run:
    """One scene, calibrated by one method.

    Attributes
    ----------
    sensor : str
        A row of the table: a kind of sensor, with ``_rendered`` appended where images were rendered, or ``detections``.
    method : str
    seed : int
    good : bool
        See `tools.scenes.worth.is_good`.
    refused : str
        The reason; empty for an accepted run.
    track_xy_cm, track_z_cm, rotation_deg, position_cm, sigma_ratio, rotation_ratio
        See `tools.scenes.scene.Errors`; NaN where there is no result.
    draw_s, observe_s, locate_s : float
        Durations; the first two are those of the scene, for all methods together; simulation is a part of observing.
    """

    sensor: str
    method: str
    seed: int
    drive: str = ""
    vehicle: str = ""
    seen: int = 0
    good: bool = False
    refused: str = ""
    verdict: str = ""
    track_xy_cm: float = np.nan
    track_z_cm: float = np.nan
    rotation_deg: float = np.nan
    position_cm: float = np.nan
    sigma_ratio: float = np.nan
    rotation_ratio: float = np.nan
    draw_s: float = 0.0
    observe_s: float = 0.0
    locate_s: float = 0.0

    @property
    def drawn(self) -> bool:
        """Whether the scene could be drawn."""
        return not self.refused.startswith(NO_SCENE)


NO_SCENE = "SceneError"


HEAD = (
    "sensor", "method", "scenes", "refused", "of good ones", "accepted (pass)", "within 3 sigma", "beyond 5 sigma",
    "xy median", "95 %", "worst cm", "rotation median", "95 %", "worst deg", "beyond 5 sigma",
)  # fmt: skip


def table(runs: Sequence[Run]) -> str:
    """Return a Markdown table with one row for each sensor and method."""
    rows = [HEAD, tuple("---" for _ in HEAD), *(_row(*key, mine) for key, mine in _by_row(runs))]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _by_row(runs: Sequence[Run]) -> Iterator[tuple[tuple[str, str], list[Run]]]:
    for key in dict.fromkeys((run.sensor, run.method) for run in runs):
        yield key, [run for run in runs if (run.sensor, run.method) == key and run.drawn]


def _row(sensor: str, method: str, mine: Sequence[Run]) -> tuple[str, ...]:
    accepted = [run for run in mine if not run.refused]
    good = [run for run in mine if run.good]
    passed = sum(run.verdict == "pass" for run in accepted)
    ratios = np.array([run.sigma_ratio for run in accepted])
    turned = np.array([run.rotation_ratio for run in accepted])
    errors = []
    for name, digits in (("track_xy_cm", 1), ("rotation_deg", 3)):
        values = np.array([getattr(run, name) for run in accepted]) if accepted else np.array([np.nan])
        errors += [f"{np.percentile(values, share):.{digits}f}" for share in (50, 95, 100)]
    return (
        sensor,
        method,
        str(len(mine)),
        _share(len(mine) - len(accepted), len(mine)),
        _share(sum(bool(run.refused) for run in good), len(good)),
        f"{len(accepted)} ({passed})",
        _share(int((ratios <= HONEST_SIGMAS).sum()), len(accepted)),
        _share(int((ratios > WRONG_SIGMAS).sum()), len(accepted)),
        *errors,
        _share(int((turned > WRONG_SIGMAS).sum()), len(accepted)),
    )


def _share(count: int, of: int) -> str:
    return f"{count}/{of} {count / of:.0%}" if of else "-"


def beyond(runs: Sequence[Run]) -> str:
    """Return the seeds of the accepted runs of each row whose error exceeds 3 sigma, and by how many sigma."""
    lines = []
    for (sensor, method), mine in _by_row(runs):
        accepted = [run for run in mine if not run.refused]
        wrong = [run for run in accepted if max(run.sigma_ratio, run.rotation_ratio) > HONEST_SIGMAS]
        seeds = ", ".join(
            f"{run.seed} (xy {run.sigma_ratio:.1f}, rotation {run.rotation_ratio:.1f}, {run.verdict})" for run in wrong
        )
        lines.append(f"  {sensor} {method}: {seeds or 'none'}")
    return "\n".join(lines)


def seconds(runs: Sequence[Run]) -> str:
    """Return the mean durations per scene for each row."""
    lines = []
    for (sensor, method), mine in _by_row(runs):
        if mine:
            draw, watch, find = (np.mean([getattr(run, f"{part}_s") for run in mine]) for part in PARTS)
            lines.append(
                f"  {sensor} {method}: {draw:.1f} drawn, {watch:.1f} simulated and observed, {find:.1f} located"
            )
    return "\n".join(lines)


PARTS = ("draw", "observe", "locate")


def reasons(runs: Sequence[Run]) -> str:
    """Return the reasons of refusals with their counts, digits masked so that similar ones are counted together."""
    refused = (run for run in runs if run.refused)
    plain = ((run.method, "".join("#" if letter.isdigit() else letter for letter in run.refused)) for run in refused)
    counted = Counter(
        f"{method}: {text.replace('##', '#').replace('##', '#').replace('#.#', '#')}"[:120] for method, text in plain
    )
    return "\n".join(f"{count:5d}  {text}" for text, count in counted.most_common())


def report(runs: Sequence[Run]) -> str:
    """Return the whole report on runs."""
    return (
        f"{table(runs)}\n\naccepted, but beyond 3 sigma:\n{beyond(runs)}\n\nrefused because:\n{reasons(runs)}\n\n"
        f"seconds per scene:\n{seconds(runs)}\n"
    )


def read_runs(path: Path) -> list[Run]:
    """Read the runs in a file, without a truncated last line."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if None not in row.values()]
    return [_parsed(row) for row in rows]


def _parsed(row: dict[str, str]) -> Run:
    values = dict[str, object]()
    for field in fields(Run):
        text = row[field.name]
        if field.type == "float":
            values[field.name] = float(text)
        elif field.type == "int":
            values[field.name] = int(text)
        else:
            values[field.name] = text == "True" if field.type == "bool" else text
    return Run(**values)  # type: ignore[arg-type]


def recorded(batches: Iterable[list[Run]], path: Path, before: Sequence[Run] = ()) -> Iterator[list[Run]]:
    """Write runs to a file as they arrive, after the earlier ones, and yield them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Run)])
        writer.writeheader()
        writer.writerows(asdict(run) for run in before)
        file.flush()
        for batch in batches:
            writer.writerows(asdict(run) for run in batch)
            file.flush()
            yield batch
