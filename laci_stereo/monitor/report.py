"""A monitor's findings in figures: ``monitor.json`` and the summary in the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, TypeAlias

import numpy as np

from laci_stereo.check.placed import Placed
from laci_stereo.io.stamps import iso_text
from laci_stereo.monitor.checkpoint import State
from laci_stereo.monitor.lanes import Strip
from laci_stereo.monitor.run import Plan
from laci_stereo.monitor.tally import StripTally

Document: TypeAlias = dict[str, Any]

SHOWN = 5
"""Number of lanes in the summary: those with most passages."""

MOST_OFF_ROAD = 0.05
"""With a larger fraction of positions off the road, the user is asked to check the map, its extent and the
calibration."""


@dataclass(frozen=True)
class LaneFinding:
    """The traffic in a lane, or beside a boundary.

    ``calibration_sigma_m`` is the standard deviation of the offset from the line according to the calibration's own
    covariance, at the point of the line nearest to the centre of the calibration's track.
    """

    strip: Strip
    tally: StripTally
    calibration_sigma_m: float


def findings(plan: Plan, placed: Placed, state: State) -> list[LaneFinding]:
    """Return the strips in which objects drove, the one with most passages first."""
    found = [
        LaneFinding(strip, state.tally.strips[strip.id], _sigma_m(strip, placed))
        for strip in plan.strips
        if strip.id in state.tally.strips
    ]
    return sorted(found, key=lambda one: one.tally.along + one.tally.against, reverse=True)


def _sigma_m(strip: Strip, placed: Placed) -> float:
    """Return the standard deviation of objects' positions across a line due to the calibration's covariance."""
    apart = np.linalg.norm(strip.xy - placed.centre_world[:2], axis=1)
    xy = strip.xy[int(apart.argmin())][None]
    yaw_rad = float(strip.locate(xy).yaw_rad[0])
    across = np.array([-np.sin(yaw_rad), np.cos(yaw_rad)]) @ placed.jacobian(xy)[0]
    return float(np.sqrt(across @ placed.covariance @ across))


def off_road_share(plan: Plan, state: State) -> float | None:
    """Return the fraction of positions in no lane; None where the map has no lanes, or nothing was seen."""
    has_lanes = any(strip.is_lane for strip in plan.strips)
    return state.tally.off_road / state.tally.positions if has_lanes and state.tally.positions else None


def document_of(plan: Plan, state: State, found: Sequence[LaneFinding], recording: str) -> Document:
    """Return the contents of ``monitor.json``."""
    tally, settings, world = state.tally, plan.settings, plan.world
    return {
        "schema": "laci-monitor/1",
        "version": version("laci-stereo"),
        "inputs": dict(state.identity),
        "recording": {
            "path": recording,
            "frames": state.frames,
            "unusable_frames": state.unusable,
            "first": iso_text(state.epoch_ns),
            "last": iso_text(state.last_ns),
            "duration_s": (state.last_ns - state.epoch_ns) / 1e9,
        },
        "world": {"crs": world.crs, "origin_utm": list(world.origin_utm), "grid_scale": world.grid_scale},
        "reference": "lanes" if any(strip.is_lane for strip in plan.strips) else "boundaries",
        "passages": tally.passages,
        "passages_along_no_lane": tally.strays,
        "positions": tally.positions,
        "position_every_m": settings.step_m,
        "off_road_share": off_road_share(plan, state),
        "lanes": [_lane(one, settings.profile_bin_m) for one in found],
        "histogram": {
            "cell_m": settings.cell_m,
            "cells": [[i, j, count] for (i, j), count in sorted(tally.cells.items())],
        },
    }


def _lane(lane: LaneFinding, bin_m: float) -> Document:
    tally = lane.tally
    return {
        "id": lane.strip.id,
        "passages": tally.along + tally.against,
        "passages_along": tally.along,
        "passages_against": tally.against if lane.strip.one_way else None,
        "offset_left_m": tally.offset_m,
        "standard_error_m": tally.error_m,
        "calibration_sigma_m": lane.calibration_sigma_m,
        "profile": {"bin_m": bin_m, "from": [[round(i * bin_m, 6), n] for i, n in sorted(tally.profile.items())]},
    }


def summary_of(plan: Plan, state: State, found: Sequence[LaneFinding]) -> str:
    """Return the summary for the terminal, about ten lines of text."""
    tally = state.tally
    duration_min = (state.last_ns - state.epoch_ns) / 6e10
    unusable = f", {state.unusable} of them unusable" if state.unusable else ""
    lines = [
        f"{'Recording':<11}{state.frames} frames in {duration_min:.1f} min{unusable}",
        f"{'Vehicles':<11}{counted(tally.passages, 'passage')}, {tally.strays} of them along no lane of the map",
    ]
    for number, one in enumerate(found[:SHOWN]):
        lines.append(f"{'Lanes' if number == 0 else '':<11}{describe(one)}")
    if len(found) > SHOWN:
        lines.append(f"{'':<11}and {len(found) - SHOWN} more in monitor.json")
    share = off_road_share(plan, state)
    if share is not None:
        remark = "; check whether the map covers the field of view" if share > MOST_OFF_ROAD else ""
        lines.append(f"{'Off road':<11}{share:.1%} of positions{remark}")
    wrong = sum(one.tally.against for one in found if one.strip.one_way)
    lines.append(f"{'Wrong way':<11}{counted(wrong, 'passage')} against the lane's direction")
    return "\n".join(lines)


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural unless it is one."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def describe(lane: LaneFinding) -> str:
    """Describe the traffic in a lane in one line: passages, mean offset, its standard error, and which side."""
    tally = lane.tally
    passages = f"{lane.strip.id}: {counted(tally.along + tally.against, 'passage')}"
    if tally.offset_m is None:
        return f"{passages}, all against its direction"
    side = "left" if tally.offset_m >= 0 else "right"
    error = "" if tally.error_m is None else f" +- {tally.error_m:.2f} m"
    of = "its middle" if lane.strip.is_lane else "the line"
    return (
        f"{passages}, {abs(tally.offset_m):.2f} m{error} {side} of {of} (the calibration's own doubt: "
        f"{lane.calibration_sigma_m:.2f} m)"
    )
