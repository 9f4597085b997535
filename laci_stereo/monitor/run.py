"""The monitor: takes frames, counts objects on the map, and writes a checkpoint after every section.

A section is a run of at most `MonitorSettings.section_frames` frames. A block is a period of
`MonitorSettings.block_s` whose frames share one static background, learnt as a rule from the block before. A section
never extends beyond its block. The static scene is what a sensor shows of a block when nothing moves.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from laci_stereo.core.cloud import MAX_BAD_SHARE
from laci_stereo.core.errors import ImageError, LaciError, OutputError
from laci_stereo.core.frames import FloatArray, planar, transform
from laci_stereo.core.settings import Settings
from laci_stereo.core.tracking.background import Background, learn_background
from laci_stereo.core.tracking.sighting import find_vehicles
from laci_stereo.core.world import World
from laci_stereo.monitor.checkpoint import State, check_same, read_state, sha256_of, write_state
from laci_stereo.monitor.frames import Frames, Scene
from laci_stereo.monitor.lanes import Strip
from laci_stereo.monitor.linking import Live
from laci_stereo.monitor.objects import header, rows_of
from laci_stereo.monitor.passage import passage_of
from laci_stereo.monitor.settings import MonitorSettings
from laci_stereo.stereo.recording import LOOK_FRAMES

log = logging.getLogger(__name__)

STATE_FILE, TABLE_FILE = "state.json", "objects.csv"

LEAST_SURVEY = LOOK_FRAMES
"""From a block with fewer frames, the background of the next block is not learnt. With fewer frames done, the fraction
of unreadable ones is not checked either."""


@dataclass(frozen=True)
class Plan:
    """The calibration, the map and the settings with which a monitor evaluates frames.

    Attributes
    ----------
    world : World
    T_world_sensor : ndarray, shape (4, 4)
    strips : tuple of Strip
        Strips of road along the lines of the map.
    identity : dict of str to str
        Hashes of the files from which the calibration and the map were read, by name.
    core : Settings
    settings : MonitorSettings
    """

    world: World
    T_world_sensor: FloatArray
    strips: tuple[Strip, ...]
    identity: dict[str, str]
    core: Settings = field(default_factory=Settings)
    settings: MonitorSettings = field(default_factory=MonitorSettings)

    @property
    def origin(self) -> FloatArray:
        """The point on the ground below the sensor, world, shape (2,)."""
        return self.T_world_sensor[:2, 3]

    @property
    def T_level_sensor(self) -> FloatArray:
        """The transform into the level frame with axes parallel to the world's, shape (4, 4)."""
        return planar(0.0, -self.origin) @ self.T_world_sensor


@dataclass(frozen=True)
class _Learnt:
    """The static scene and its background, learnt from a range of frames."""

    frames: range
    scene: Scene
    background: Background


class Monitor:
    """Processes the frames of a recording, section by section.

    Parameters
    ----------
    frames : Frames
    plan : Plan
    out : Path
        Existing folder for the checkpoint and the table.

    Attributes
    ----------
    state : State
        The state at the latest checkpoint, except while a section is being processed.
    resumed : bool
        Whether the folder held a checkpoint at the start.
    """

    def __init__(self, frames: Frames, plan: Plan, out: Path) -> None:
        self.frames, self.plan, self.out = frames, plan, out
        self.state = State({})
        self._learnt: _Learnt | None = None
        self.resumed = (out / STATE_FILE).exists()
        if self.resumed:
            self.state = read_state(out / STATE_FILE, plan.core.track)
        self._check_table()

    def refresh(self) -> None:
        """Look for new frames; when the first ones appear, record the identity and the epoch in the state.

        Raises
        ------
        InputError
            If the frames cannot be listed.
        """
        self.frames.refresh(self.state.frames)
        if self.state.identity or not len(self.frames.stamps_ns):
            return
        self.state.identity = self._identity()
        self.state.epoch_ns = int(self.frames.stamps_ns[0])

    def check(self) -> None:
        """Check that the checkpoint belongs to this recording, calibration, map and settings.

        Raises
        ------
        OutputError
            If it does not.
        """
        path, done, stamps = self.out / STATE_FILE, self.state.frames, self.frames.stamps_ns
        if not self.resumed:
            return
        if len(stamps) < done:
            raise OutputError(
                f"{path}: {done} frames are done; needed is their recording, but {self.frames.uri} has {len(stamps)} "
                "frames, another --out, or --overwrite to start afresh"
            )
        check_same(path, self.state.identity, self._identity())
        if sha256_of(stamps[:done]) != self.state.stamps_sha256:
            raise OutputError(
                f"{path}: the recording's first {done} frames had other times; needed is the recording that the "
                "checkpoint is of, another --out, or --overwrite to start afresh"
            )

    def step(self, *, ended: bool) -> bool:
        """Process the next section and write a checkpoint.

        Parameters
        ----------
        ended : bool
            Whether no more frames will arrive. Otherwise an incomplete section is not processed yet, nor is a section
            whose background has to be learnt from its own, incomplete block.

        Returns
        -------
        bool
            Whether there was a section to process.

        Raises
        ------
        LaciError
        """
        section = self._next(ended=ended)
        if section is None:
            return False
        learnt = self._against(section.start)
        lines = []
        plan, epoch_ns = self.plan, self.state.epoch_ns
        clouds = learnt.scene.section(section)
        for number, cloud in zip(section, clouds, strict=True):
            now_s = (cloud.stamp_ns - epoch_ns) / 1e9
            seen = find_vehicles(cloud, now_s, plan.T_level_sensor, learnt.background, plan.core)
            over = self.state.linker.add(number, now_s, seen, plan.core, plan.settings.longest_s)
            lines += self._counted(over)
        self.state.unusable += learnt.scene.unusable
        self._append(lines)
        stamps_ns = self.frames.stamps_ns
        self.state.frames, self.state.last_ns = section.stop, int(stamps_ns[section.stop - 1])
        self.state.stamps_sha256 = sha256_of(stamps_ns[: section.stop])
        write_state(self.out / STATE_FILE, self.state)
        self._check_readable()
        return True

    def back(self) -> State:
        """Reset the state to the latest checkpoint, or to the beginning if there is none, and return it."""
        path = self.out / STATE_FILE
        if path.exists():
            self.state = read_state(path, self.plan.core.track)
        else:
            self.state = State(self.state.identity, epoch_ns=self.state.epoch_ns, table_bytes=len(header()))
        return self.state

    def finish(self) -> State:
        """Count the objects still in view at the latest checkpoint, and return all counts; the checkpoint is kept."""
        if self.back().frames:
            self._append(self._counted(self.state.linker.rest(self.plan.core.track)))
        return self.state

    @property
    def longest_frames(self) -> int:
        """Upper bound of a track's length in frames: 1.2 times `MonitorSettings.longest_s` at the median interval."""
        stamps_ns = self.frames.stamps_ns
        if len(stamps_ns) < 2:
            return 1
        return int(1.2e9 * self.plan.settings.longest_s / float(np.median(np.diff(stamps_ns)))) + 1

    def _next(self, *, ended: bool) -> range | None:
        """Return the frames of the next section, all in one block; None if the section has to wait for more frames."""
        stamps, start, size = self.frames.stamps_ns, self.state.frames, self.plan.settings.section_frames
        if start >= len(stamps):
            return None
        stretch_end = self._stretch(start).stop
        stop = min((start // size + 1) * size, stretch_end)
        whole = len(stamps) > stop or ended
        first_seen = self._survey(start).start < start or len(stamps) > stretch_end or ended
        return range(start, stop) if whole and first_seen else None

    def _stretch(self, frame: int) -> range:
        """Return the known frames of a frame's block, which share one background."""
        stamps = self.frames.stamps_ns
        block_ns = round(self.plan.settings.block_s * 1e9)
        block = (int(stamps[frame]) - int(stamps[0])) // block_ns
        edges = int(stamps[0]) + np.array([block, block + 1]) * block_ns
        start, stop = np.searchsorted(stamps, edges)
        return range(int(start), int(stop))

    def _survey(self, frame: int) -> range:
        """Return the frames from which a frame's background is learnt.

        These are the frames of the block before, if it has at least `LEAST_SURVEY`, or else of the frame's own block.
        """
        block = self._stretch(frame)
        if block.start == 0:
            return block
        before = self._stretch(block.start - 1)
        return before if len(before) >= LEAST_SURVEY else block

    def _against(self, frame: int) -> _Learnt:
        frames = self._survey(frame)
        if self._learnt is None or self._learnt.frames != frames:
            self._learnt = replace(self._learn(frames), frames=frames)
            log.info("from frame %d: background of %d boxes", frame, len(self._learnt.background.boxes))
        return self._learnt

    def _learn(self, frames: range) -> _Learnt:
        """Learn the static scene from a range of frames, or from earlier ones where these do not show it, as in fog."""
        core = self.plan.core
        try:
            scene = self.frames.learn(frames)
            clouds = [transform(self.plan.T_level_sensor, cloud.points) for cloud in scene.survey()]
            background = learn_background(
                clouds, float(self.plan.T_level_sensor[2, 3]), core.background, core.cluster, core.box
            )
        except LaciError as problem:
            before = self._survey(frames.start)
            if before.start >= frames.start:
                raise
            log.warning("frames %d to %d do not show the scene at rest: %s", frames.start, frames.stop - 1, problem)
            return self._learn(before)
        return _Learnt(frames, scene, background)

    def _counted(self, over: Iterable[Live]) -> list[bytes]:
        plan, state = self.plan, self.state
        lines = []
        for live in over:
            passage = passage_of(live.kept, plan.origin, plan.core.track, plan.settings)
            if passage is None:
                continue
            lane = state.tally.count(passage, plan.strips, plan.settings)
            state.objects += 1
            lines.append(rows_of(passage, state.objects, lane, state.epoch_ns, plan.world))
        return lines

    def _append(self, lines: Iterable[bytes]) -> None:
        """Append lines at the table's length by the checkpoint; what an aborted run wrote beyond it is cut off."""
        with (self.out / TABLE_FILE).open("r+b") as table:
            table.truncate(self.state.table_bytes)
            table.seek(self.state.table_bytes)
            for line in lines:
                self.state.table_bytes += table.write(line)

    def _check_table(self) -> None:
        """Create the table unless resuming, and check its length against the checkpoint.

        Raises
        ------
        OutputError
            If the table is shorter than by the checkpoint.
        """
        path = self.out / TABLE_FILE
        if not self.resumed:
            path.write_bytes(header())
            self.state.table_bytes = len(header())
        size = path.stat().st_size if path.exists() else 0
        if size < self.state.table_bytes:
            raise OutputError(
                f"{path}: holds {size} bytes; needed are at least {self.state.table_bytes} by {STATE_FILE}, or "
                "--overwrite to start afresh"
            )

    def _check_readable(self) -> None:
        state = self.state
        if state.frames >= LEAST_SURVEY and state.unusable > MAX_BAD_SHARE * state.frames:
            raise ImageError(
                f"{self.frames.uri}: {state.unusable} of {state.frames} frames are unusable; needed are at least "
                f"{1 - MAX_BAD_SHARE:.0%} usable ones"
            )

    def _identity(self) -> dict[str, str]:
        return {**self.plan.identity, **self.frames.identity}
