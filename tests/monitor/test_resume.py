"""Killed at any moment and started again, a monitor ends as if nothing had happened; and it does not grow."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from laci_stereo.core.errors import ImageError, OutputError
from laci_stereo.core.settings import TrackSettings
from laci_stereo.monitor.checkpoint import check_same, read_state, write_state
from laci_stereo.monitor.run import Monitor
from tests.monitor.support import COARSE, Killed, Traffic, drive, gone_through, lane, one_by_one, plan, traffic
from tests.simulated import Drive, car

FILES = ("objects.csv", "state.json")

SOURCE = traffic(
    [car(drive(0.2)), car(Drive((26.0, -24.0), 90.0, speeds=((0.0, 9.0),)))],
    [car(drive(-0.1, 6.0))],
    [car(drive(against=True)), car(Drive((30.0, 2.0), 30.0, speeds=((0.0, 0.0),)))],
    sensor=COARSE,
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Monitor:
    return gone_through(SOURCE, plan(SOURCE), tmp_path_factory.mktemp("whole"))


def killed_at(frame: int, out: Path) -> None:
    with pytest.raises(Killed):
        gone_through(replace(SOURCE, killed_at=frame), plan(SOURCE), out)


def contents(out: Path) -> dict[str, bytes]:
    return {name: (out / name).read_bytes() for name in FILES}


@pytest.mark.parametrize(
    "frames", [(3, 26, 40), *(pytest.param(at, marks=pytest.mark.slow) for at in ((61, 99, 148), (75, 76, 100)))]
)
def test_killed_and_started_again_ends_the_same_byte_for_byte(
    whole: Monitor, tmp_path: Path, frames: tuple[int, ...]
) -> None:
    out = tmp_path / "out"
    for frame in frames:
        killed_at(frame, out)
    resumed = gone_through(SOURCE, plan(SOURCE), out)
    assert resumed.state.objects == whole.state.objects > 0
    assert contents(out) == contents(whole.out)
    assert resumed.state.tally == whole.state.tally


@pytest.mark.slow
@pytest.mark.parametrize("junk", [b"7,3,17", b"\x00\xff" * 5000])
def test_half_written_lines_are_cut(whole: Monitor, tmp_path: Path, junk: bytes) -> None:
    out = tmp_path / "out"
    killed_at(110, out)
    with (out / "objects.csv").open("ab") as table:
        table.write(junk)
    gone_through(SOURCE, plan(SOURCE), out)
    assert contents(out) == contents(whole.out)


@pytest.mark.slow
def test_run_that_is_done_stays_done(whole: Monitor, tmp_path: Path) -> None:
    gone_through(SOURCE, plan(SOURCE), tmp_path)
    assert gone_through(SOURCE, plan(SOURCE), tmp_path).resumed
    assert contents(tmp_path) == contents(whole.out)


@pytest.mark.slow
def test_longer_recording_goes_on_where_the_shorter_one_ended(tmp_path: Path) -> None:
    longer = one_by_one(*[drive(0.1)] * 4, sensor=COARSE)
    shorter = replace(longer, episodes=longer.episodes[:2])
    # Twice the first stretch, which is complete in both, so that the same is learnt of it.
    short_blocks = plan(longer, block_s=5.0)
    gone_through(shorter, short_blocks, tmp_path / "grown")
    gone_through(longer, short_blocks, tmp_path / "grown")
    gone_through(longer, short_blocks, tmp_path / "whole")
    assert contents(tmp_path / "grown") == contents(tmp_path / "whole")


def test_checkpoint_is_what_it_was_written_from(whole: Monitor, tmp_path: Path) -> None:
    state = read_state(whole.out / "state.json", TrackSettings())
    write_state(tmp_path / "again.json", state)
    assert (tmp_path / "again.json").read_bytes() == (whole.out / "state.json").read_bytes()


@pytest.mark.slow
def test_neither_state_nor_checkpoint_grows_with_time(tmp_path: Path) -> None:
    sizes = []
    for laps in (2, 5):
        source = one_by_one(*[drive()] * laps, sensor=COARSE)
        out = tmp_path / str(laps)
        monitor = gone_through(source, plan(source), out)
        assert monitor.state.tally.passages == laps
        sizes.append((out / "state.json").stat().st_size)
        state = read_state(out / "state.json", TrackSettings())
        assert len(state.linker.active) + len(state.linker.lost) <= 3
    assert sizes[1] < 1.2 * sizes[0]


def test_long_wait_is_cut(tmp_path: Path) -> None:
    """What stands for ever does not pile up: it is cut, and only what moves is counted."""
    source = traffic(*[[car(Drive((LANE, 10.0), -90.0, speeds=((0.0, 0.0),)))]] * 3, sensor=COARSE)
    asked = plan(source, longest_s=4.0, block_s=1000.0)
    monitor = Monitor(source, asked, tmp_path)
    monitor.refresh()
    most = 0
    while monitor.step(ended=True):
        most = max([most, *(len(live.kept) for live in monitor.state.linker.active)])
    assert most <= 42
    assert monitor.state.tally.passages == 0


LANE = 22.0


def test_checkpoint_of_another_calibration_is_refused(whole: Monitor, tmp_path: Path) -> None:
    other = replace(plan(SOURCE), identity={"calibration": "b"})
    killed_at(61, tmp_path / "out")
    with pytest.raises(
        OutputError,
        match=r"state\.json: the checkpoint's calibration is a, asked for is now b; needed is .*--overwrite",
    ):
        gone_through(SOURCE, other, tmp_path / "out")


def test_contents_that_differ_are_not_told_by_their_hashes(tmp_path: Path) -> None:
    path, (one, other) = tmp_path / "state.json", [hashlib.sha256(word).hexdigest() for word in (b"one", b"other")]
    check_same(path, {"calibration": one}, {"calibration": one})
    with pytest.raises(OutputError, match=r"calibration is \w{8}\.{3}, .* it is another one") as refused:
        check_same(path, {"calibration": one}, {"calibration": other})
    assert one not in str(refused.value)
    with pytest.raises(OutputError, match="the checkpoint's mask is not set, asked for is now "):
        check_same(path, {}, {"mask": other})


def test_checkpoint_of_another_recording_is_refused(tmp_path: Path) -> None:
    killed_at(61, tmp_path / "out")
    with pytest.raises(OutputError, match="the checkpoint's first scan is first, asked for is now second"):
        gone_through(replace(SOURCE, identity_="second"), plan(SOURCE), tmp_path / "out")
    killed_at(80, tmp_path / "out")
    with pytest.raises(OutputError, match=r"75 frames are done; .* has 50 frames"):
        gone_through(replace(SOURCE, episodes=SOURCE.episodes[:1]), plan(SOURCE), tmp_path / "out")

    class Later(Traffic):
        @property
        def stamps_ns(self) -> np.ndarray:  # type: ignore[type-arg]
            return super().stamps_ns + 1

    with pytest.raises(OutputError, match="first 75 frames had other times"):
        gone_through(Later(SOURCE.episodes, SOURCE.sensor), plan(SOURCE), tmp_path / "out")


def without_schema(text: str) -> str:
    return text.replace("laci-monitor-state/2", "laci-monitor-state/0")


def cut(text: str) -> str:
    return text[: len(text) // 2]


def no_tally(text: str) -> str:
    document = json.loads(text)
    del document["tally"]
    return json.dumps(document)


@pytest.mark.parametrize("spoil", [without_schema, cut, no_tally, lambda _: "[]", lambda _: "", lambda _: "\x00"])
def test_damaged_checkpoint_is_refused(whole: Monitor, tmp_path: Path, spoil: Callable[[str], str]) -> None:
    for name in FILES:
        (tmp_path / name).write_bytes((whole.out / name).read_bytes())
    state = tmp_path / "state.json"
    state.write_text(spoil(state.read_text()))
    with pytest.raises(OutputError, match=r"state\.json.*needed.*--overwrite"):
        gone_through(SOURCE, plan(SOURCE), tmp_path)


def test_table_that_lost_lines_is_refused(whole: Monitor, tmp_path: Path) -> None:
    for name in FILES:
        (tmp_path / name).write_bytes((whole.out / name).read_bytes()[: 10 if name == "objects.csv" else None])
    with pytest.raises(OutputError, match=r"objects\.csv: holds 10 bytes; needed are at least"):
        gone_through(SOURCE, plan(SOURCE), tmp_path)


def test_many_unusable_frames_are_an_error(tmp_path: Path) -> None:
    class Broken(Traffic):
        def learn(self, frames: range):  # type: ignore[no-untyped-def]
            scene = super().learn(frames)
            scene.unusable = 20
            return scene

    source = Broken(SOURCE.episodes, SOURCE.sensor)
    with pytest.raises(ImageError, match="40 of 50 frames are unusable; needed are at least 80%"):
        gone_through(source, plan(source, lane()), tmp_path)
