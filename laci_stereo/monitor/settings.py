"""All settings of the monitor, their defaults, and the reasons for these values."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MonitorSettings:
    """Settings for tracking, placing and counting objects.

    Attributes
    ----------
    block_s : float
        Duration of a block; the static scene learnt from each block serves for the next one. Traffic signals have
        cycles of 120 s at most, so a queue is stationary for less than half of two cycles; shadows rotate by 1 deg in
        that time.
    section_frames : int
        Number of frames between checkpoints: at 10 Hz, a kill costs the work on 10 s of recording.
    longest_s : float
        A track that lasts longer is cut: an object stationary for longer than two blocks is background by then.
    min_path_m : float
        An object that moves by less is not counted: the middle of the visible part of vegetation wanders as far.
    min_frames, least_frames : int
        Least number of frames in which the outline of a counted object is whole: those of a second, but no more than
        the one and no fewer than the other. Four are the fewest of which one is above the quantile that is the length
        (`passage.LENGTH_SHARE`); at 2 Hz a car at 14 m/s is in no more than six frames of a view 40 m wide.
    step_m : float
        Interval along an object's path at which its position is counted, regardless of its speed and of how long it
        waits: the side of a cell, so that the path has no gaps.
    cell_m : float
        Side of the histogram's cells: half of the largest position standard deviation of a calibration that passes.
    profile_bin_m : float
        Width of the bins across a lane.
    min_in_lane_m : float
        Least distance travelled in a lane for a passage to count in it: the length of a car, so that an object that
        crosses the lane does not count.
    aligned_deg : float
        Largest angle between an object's heading and a lane's line, either way, at which it drives along or against
        the lane; at larger angles it crosses it. This is twice the angle of a lane change, 3.5 m in 3 s at 10 m/s.
    boundary_reach_m : float
        Width of the strips on either side of a boundary, in a map without lanes: the centre of a vehicle is no farther
        from one of its lane's boundaries than half of the widest lane, 3.75 m, plus half a metre off its middle.
    """

    block_s: float = 240.0
    section_frames: int = 100
    longest_s: float = 480.0
    min_path_m: float = 10.0
    min_frames: int = 10
    least_frames: int = 4
    step_m: float = 0.25
    cell_m: float = 0.25
    profile_bin_m: float = 0.1
    min_in_lane_m: float = 5.0
    aligned_deg: float = 15.0
    boundary_reach_m: float = 2.4
