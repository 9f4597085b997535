"""What is said and drawn of what was counted."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from laci_stereo.check.placed import Placed
from laci_stereo.io.maps.lane_map import LaneLine, LaneMap
from laci_stereo.io.maps.lanelets import lane_between
from laci_stereo.monitor.checkpoint import State
from laci_stereo.monitor.lanes import strips_of
from laci_stereo.monitor.picture import MAP, draw_histogram
from laci_stereo.monitor.report import document_of, findings, summary_of
from laci_stereo.monitor.run import Plan
from laci_stereo.monitor.tally import StripTally, Tally
from tests.monitor.support import EAST, WORLD, gone_through, one_by_one, plan

T = np.eye(4)
T[:3, 3] = (0.0, 0.0, 6.0)
NORTHWARD = np.array([[10.0, -30.0], [10.0, 30.0]])
LINES = LaneMap((LaneLine("line_thin", "solid", NORTHWARD + EAST, "3"),), ())


def asked() -> Plan:
    north = lane_between("north", NORTHWARD - EAST, NORTHWARD + EAST, one_way=True)
    east = lane_between("east", NORTHWARD[:, ::-1] + EAST[::-1], NORTHWARD[:, ::-1] - EAST[::-1], one_way=True)
    assert north is not None
    assert east is not None
    return Plan(WORLD, T, strips_of(LaneMap((), ()), [north, east], 2.4), {})


def placed(covariance: np.ndarray) -> Placed:  # type: ignore[type-arg]
    return Placed(T, covariance, np.array([10.0, 10.0, 0.0]), np.zeros((0, 6)))


def counted(**strips: StripTally) -> State:
    cells = Counter({(20, i): 1 + i for i in range(80)})
    tally = Tally(passages=12, strays=2, positions=sum(cells.values()), off_road=81, cells=cells, strips=strips)
    return State({}, frames=600, epoch_ns=10**18, last_ns=10**18 + 60 * 10**9, tally=tally)


def test_calibrations_own_doubt_is_across_the_lane() -> None:
    covariance = np.zeros((6, 6))
    covariance[3, 3] = 0.2**2  # its place is in doubt to the east
    state = counted(north=StripTally(along=1), east=StripTally(along=1))
    sigmas = {one.strip.id: one.calibration_sigma_m for one in findings(asked(), placed(covariance), state)}
    assert sigmas["north"] == pytest.approx(0.2)
    assert sigmas["east"] == pytest.approx(0.0, abs=1e-9)


def test_figures_are_those_that_were_counted() -> None:
    offsets = np.array([0.1, 0.3, 0.5, 0.3])
    north = StripTally(4, 1, float(offsets.sum()), float((offsets**2).sum()), Counter({1: 5, 3: 10, 5: 5}))
    state = counted(north=north, east=StripTally(against=2))
    found = findings(asked(), placed(np.eye(6) * 1e-6), state)
    figures = document_of(asked(), state, found, "scans")
    first, second = figures["lanes"]
    assert (first["id"], first["passages"], first["passages_against"]) == ("north", 5, 1)
    assert first["offset_left_m"] == pytest.approx(0.3)
    assert first["standard_error_m"] == pytest.approx(offsets.std(ddof=1) / 2)
    assert (second["offset_left_m"], second["standard_error_m"]) == (None, None)
    assert figures["off_road_share"] == pytest.approx(0.025)
    assert figures["recording"]["duration_s"] == 60.0
    said = summary_of(asked(), state, found)
    assert "north: 5 passages, 0.30 m +- 0.08 m left of its middle" in said
    assert "2.5% of positions" in said
    assert "3 passages against the lane's direction" in said


def test_picture_is_darkest_where_most_drove() -> None:
    state = counted(north=StripTally(12, 0, 1.2, 0.5, Counter({1: 100})))
    picture = draw_histogram(asked(), state, findings(asked(), placed(np.eye(6) * 1e-6), state), LINES)
    assert picture.shape == (1000, 1600, 3)
    left, top, right, bottom = (round(edge) for edge in MAP)
    # Of the column of cells the lower end is light and the upper one dark; north is up.
    column = picture[top + 60 : bottom - 60, (left + right) // 2].astype(int).sum(axis=1)
    coloured = np.flatnonzero(column < 740)
    assert column[coloured[:20]].mean() < column[coloured[-20:]].mean() - 100


def test_no_legend_lies_on_what_was_counted() -> None:
    """Who drives all along the east, and some way along the west, leaves the corners in the west free."""
    cells = Counter({cell: 5 for j in range(320) for cell in ((320, -j), (0, -100 - j // 3))})
    state = State({}, 600, 10**18, 10**18 + 60 * 10**9, tally=Tally(12, 0, sum(cells.values()), 0, cells, {}))
    plain = replace(asked(), strips=())
    picture = draw_histogram(plain, state, [], LaneMap((), ()))
    left, top, right, bottom = (round(edge) for edge in MAP)
    dark = cv2.applyColorMap(np.zeros((1, 1), dtype=np.uint8), cv2.COLORMAP_CIVIDIS)[0, 0]
    shaded = 255.0 - 0.2 * (255.0 - dark)
    assert np.abs(picture[top:bottom, left:right] - shaded).max(axis=2).min() > 2.0


def test_nothing_seen_is_said_and_drawn(tmp_path: Path) -> None:
    source = one_by_one()
    empty = State({}, frames=600, epoch_ns=10**18, last_ns=10**18)
    found = findings(asked(), placed(np.eye(6)), empty)
    assert found == []
    assert "0 passages" in summary_of(asked(), empty, found)
    assert document_of(asked(), empty, found, "scans")["off_road_share"] is None
    assert (draw_histogram(asked(), empty, found, LINES) < 255).any()
    assert gone_through(source, plan(source), tmp_path / "out").state.frames == 0
