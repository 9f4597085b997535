"""The monitor: frames in, objects counted on the map, with a checkpoint after every section."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from laci_stereo.core.background import Background, learn_background
from laci_stereo.core.errors import ImageError, LaciError, OutputError
from laci_stereo.core.frames import FloatArray, planar, transform
from laci_stereo.core.settings import Settings
from laci_stereo.core.sighting import find_vehicles
from laci_stereo.core.world import World
from laci_stereo.monitor.checkpoint import State, check_same, read_state, sha256_of, write_state
from laci_stereo.monitor.frames import Frames, Scene
from laci_stereo.monitor.lanes import Strip
from laci_stereo.monitor.linking import Live
from laci_stereo.monitor.objects import header, rows_of
from laci_stereo.monitor.passage import passage_of
from laci_stereo.monitor.settings import MonitorSettings

log = logging.getLogger(__name__)

STATE_FILE, TABLE_FILE = "state.json", "objects.csv"
MAX_BAD_SHARE = 0.2
"""A larger share of unreadable frames is an error."""

LEAST_SURVEY = 31
"""Frames from which the scene at rest is learnt at best; a stretch with fewer does not tell it for the next one."""


@dataclass(frozen=True)
class Plan:
    """What a monitor holds frames against.

    Attributes
    ----------
    world : World
    T_world_sensor : ndarray, shape (4, 4)
    strips : tuple of Strip
    identity : dict of str to str
        Hashes of what that was read from.
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
        """The place below the sensor, world, shape (2,)."""
        return self.T_world_sensor[:2, 3]

    @property
    def T_level_sensor(self) -> FloatArray:
        """The transform into a level frame whose axes are the world's, shape (4, 4)."""
        return planar(0.0, -self.origin) @ self.T_world_sensor


@dataclass(frozen=True)
class _Learnt:
    """The scene at rest as some frames show it."""

    frames: range
    scene: Scene
    background: Background


class Monitor:
    """Goes through the frames of a recording, section by section.

    Parameters
    ----------
    frames : Frames
    plan : Plan
    out : Path
        Folder for the checkpoint and the table, which exists.

    Attributes
    ----------
    state : State
        As of the latest checkpoint, while no section is in work.
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
        """Look for more frames.

        Raises
        ------
        InputError
            If they cannot be listed.
        """
        self.frames.refresh(self.state.frames)
        if self.state.identity or not len(self.frames.stamps_ns):
            return
        self.state.identity = self._identity()
        self.state.epoch_ns = int(self.frames.stamps_ns[0])

    def check(self) -> None:
        """Hold the checkpoint against what is asked for now.

        Raises
        ------
        OutputError
            If it is of something else.
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
        """Go through the next section, and write a checkpoint; tell whether there was one.

        Parameters
        ----------
        ended : bool
            Whether no more frames are to come; if not, sections and first stretches wait until they are complete.

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
        """Go back to the latest checkpoint, or to the beginning where there is none."""
        path = self.out / STATE_FILE
        if path.exists():
            self.state = read_state(path, self.plan.core.track)
        else:
            self.state = State(self.state.identity, epoch_ns=self.state.epoch_ns, table_bytes=len(header()))
        return self.state

    def finish(self) -> State:
        """Count what is still in view at the latest checkpoint, and return all counts; the checkpoint stays."""
        if self.back().frames:
            self._append(self._counted(self.state.linker.rest(self.plan.core.track)))
        return self.state

    @property
    def longest_frames(self) -> int:
        """How many frames a track lasts at most, with some to spare."""
        stamps_ns = self.frames.stamps_ns
        if len(stamps_ns) < 2:
            return 1
        return int(1.2e9 * self.plan.settings.longest_s / float(np.median(np.diff(stamps_ns)))) + 1

    def _next(self, *, ended: bool) -> range | None:
        """Return the frames of the next section: none of them beyond a stretch of its own background."""
        stamps, start, size = self.frames.stamps_ns, self.state.frames, self.plan.settings.section_frames
        if start >= len(stamps):
            return None
        stretch_end = self._stretch(start).stop
        stop = min((start // size + 1) * size, stretch_end)
        whole = len(stamps) > stop or ended
        first_seen = self._survey(start).start < start or len(stamps) > stretch_end or ended
        return range(start, stop) if whole and first_seen else None

    def _stretch(self, frame: int) -> range:
        """Return the known frames that share a background with a frame."""
        stamps = self.frames.stamps_ns
        block_ns = round(self.plan.settings.block_s * 1e9)
        block = (int(stamps[frame]) - int(stamps[0])) // block_ns
        edges = int(stamps[0]) + np.array([block, block + 1]) * block_ns
        start, stop = np.searchsorted(stamps, edges)
        return range(int(start), int(stop))

    def _survey(self, frame: int) -> range:
        """Return the frames from which the background of a frame is learnt: of the stretch before, if it has some."""
        own = self._stretch(frame)
        if own.start == 0:
            return own
        before = self._stretch(own.start - 1)
        return before if len(before) >= LEAST_SURVEY else own

    def _against(self, frame: int) -> _Learnt:
        frames = self._survey(frame)
        if self._learnt is None or self._learnt.frames != frames:
            self._learnt = replace(self._learn(frames), frames=frames)
            log.info("from frame %d: background of %d boxes", frame, len(self._learnt.background.boxes))
        return self._learnt

    def _learn(self, frames: range) -> _Learnt:
        """Learn the scene at rest from some frames, or from those before where they do not show it, as in fog."""
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
        """Write behind what the table has by the checkpoint; what a kill left there is cut."""
        with (self.out / TABLE_FILE).open("r+b") as table:
            table.truncate(self.state.table_bytes)
            table.seek(self.state.table_bytes)
            for line in lines:
                self.state.table_bytes += table.write(line)

    def _check_table(self) -> None:
        """Make the table where there is none, and hold its length against the checkpoint.

        Raises
        ------
        OutputError
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
