"""Every setting of the object histogram, its default, and why it has that value."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MonitorSettings:
    """How objects are followed, placed and counted.

    Attributes
    ----------
    block_s : float
        The scene at rest is learnt anew from each such stretch of time, for the next one. Signals turn round within
        120 s at most, so that a queue stands in less than half of two turns; shadows move by 1 deg in that time.
    section_frames : int
        After so many frames there is a checkpoint: at 10 Hz a kill costs 10 s of recording.
    longest_s : float
        A track that lasts longer is cut: what stands for longer than two blocks is background by then.
    min_path_m : float
        An object that covers less does not count: over less, the middle of what is visible of growth wanders too.
    min_frames : int
        Frames in which an object's outline is whole.
    step_m : float
        An object counts once in so many metres of its way, wherever it drives, however long it waits: the side of a
        cell, so that its way has no gaps.
    cell_m : float
        Side of the histogram's cells: half of what a calibration that passes is wrong by at most, one sigma.
    profile_bin_m : float
        Width of the bins across a lane.
    min_in_lane_m : float
        Way in a lane from which a passage counts for it: the length of a car, so that who crosses it does not.
    aligned_deg : float
        Who drives within this of a lane's line drives along it, or against it; others cross it. It is twice what a
        change of lanes takes, 3.5 m in 3 s at 10 m/s.
    boundary_reach_m : float
        In a map without lanes: the centre of a vehicle is no farther from one of its lane's boundaries than half of
        the widest lane, 3.75 m, and half a metre out of its middle.
    """

    block_s: float = 240.0
    section_frames: int = 100
    longest_s: float = 480.0
    min_path_m: float = 10.0
    min_frames: int = 10
    step_m: float = 0.25
    cell_m: float = 0.25
    profile_bin_m: float = 0.1
    min_in_lane_m: float = 5.0
    aligned_deg: float = 15.0
    boundary_reach_m: float = 2.4
