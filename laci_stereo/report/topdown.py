from __future__ import annotations


def draw_topdown(calibration, lane_map=None): ...
