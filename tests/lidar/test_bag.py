from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from laci_lidar.errors import ScanError
from laci_lidar.scans import open_scans
from laci_lidar.sequence import ScanSequence
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2

from tests.io.support import fuzz, mutations, read_or_refused
from tests.lidar.support import (
    CLOUD,
    EPOCH_NS,
    PERIOD_NS,
    ROS1,
    ROS2,
    cloud_message,
    records_of,
    refusal,
    scene,
    write_bag1,
    write_bag2,
    xyz_of,
)

SCANS = [scene(seed, 2000) for seed in range(10)]
"""Some chunks of a bag."""

BAGS: dict[str, Callable[[Path], Path]] = {
    "ros 1": lambda folder: write_bag1(folder / "a.bag", {"/points": SCANS}),
    "ros 1 lz4": lambda folder: write_bag1(folder / "a.bag", {"/points": SCANS}, "lz4"),
    "ros 1 bz2": lambda folder: write_bag1(folder / "a.bag", {"/points": SCANS}, "bz2"),
    "sqlite": lambda folder: write_bag2(folder / "a", {"/points": SCANS}),
    "sqlite file": lambda folder: write_bag2(folder / "a", {"/points": SCANS}) / "a.db3",
    "sqlite zstd messages": lambda folder: write_bag2(folder / "a", {"/points": SCANS}, compression="message"),
    "sqlite zstd file": lambda folder: write_bag2(folder / "a", {"/points": SCANS}, compression="file"),
    "sqlite big-endian points": lambda folder: write_bag2(folder / "a", {"/points": SCANS}, big_endian=True),
    "mcap bag": lambda folder: write_bag2(folder / "a", {"/points": SCANS}, "mcap"),
    "mcap file": lambda folder: write_bag2(folder / "a", {"/points": SCANS}, "mcap") / "a.mcap",
    "mcap zstd": lambda folder: write_bag2(folder / "a", {"/points": SCANS}, "mcap", "storage") / "a.mcap",
}


def assert_same(sequence: ScanSequence, indices: Sequence[int]) -> None:
    for scan, i in zip(sequence.read(indices, 2), indices, strict=True):
        assert scan is not None
        np.testing.assert_array_equal(scan.points, xyz_of(SCANS[i]))
        np.testing.assert_array_equal(scan.intensity, SCANS[i]["intensity"])
        np.testing.assert_allclose(scan.offset_s, SCANS[i]["t"] / 1e9, atol=1e-9)


@pytest.mark.parametrize("form", BAGS)
def test_every_kind_of_bag_gives_the_same_scans(form: str, tmp_path: Path):
    bag = open_scans(BAGS[form](tmp_path))
    assert bag.stamps_ns.tolist() == [EPOCH_NS + i * PERIOD_NS for i in range(10)]
    assert_same(bag, range(10))
    assert_same(bag, [2, 7])
    assert bag.notes == ()
    assert bag.skipped == {}


def test_the_headers_time_counts_and_not_that_of_recording(tmp_path: Path):
    bag = open_scans(write_bag1(tmp_path / "a.bag", {"/points": SCANS}, delay_ns=40_000_000))
    assert bag.stamps_ns.tolist() == [EPOCH_NS + i * PERIOD_NS for i in range(10)]


def test_without_times_in_headers_those_of_recording_are_used(tmp_path: Path):
    bag = open_scans(write_bag2(tmp_path / "a", {"/points": SCANS}, stamps_ns=[0] * 10))
    assert bag.stamps_ns.tolist() == [EPOCH_NS + i * PERIOD_NS for i in range(10)]
    assert "times of recording" in bag.notes[0]
    assert_same(bag, [3])


def test_messages_that_go_back_in_time_are_left_out_and_counted(tmp_path: Path):
    stamps = [EPOCH_NS + i * PERIOD_NS for i in (0, 1, 2, 2, 4, 3, 6, 7, 8, 9)]
    bag = open_scans(write_bag2(tmp_path / "a", {"/points": SCANS}, "mcap", stamps_ns=stamps))
    assert bag.stamps_ns.tolist() == [stamps[i] for i in (0, 1, 2, 4, 6, 7, 8, 9)]
    assert "2 messages of /points are left out" in bag.notes[0]
    for scan, i in zip(bag.read(range(8), 1), (0, 1, 2, 4, 6, 7, 8, 9), strict=True):
        assert scan is not None
        np.testing.assert_array_equal(scan.points, xyz_of(SCANS[i]))


@pytest.mark.parametrize("storage", ["ros 1", "sqlite3", "mcap"])
def test_a_topic_is_chosen_or_asked_for(storage: str, tmp_path: Path):
    def write(topics: Sequence[str]) -> Path:
        for old in tmp_path.iterdir():
            shutil.rmtree(old) if old.is_dir() else old.unlink()
        scans = dict.fromkeys(topics, SCANS[:3])
        return (
            write_bag1(tmp_path / "a.bag", scans) if storage == "ros 1" else write_bag2(tmp_path / "a", scans, storage)
        )

    path = write(["/left", "/right"])
    assert "needed is --topic with one of /left, /right" in refusal(path)
    assert len(open_scans(path, "/left")) == len(open_scans(path, "right")) == 3
    assert "no topic '/middle'; it has /chatter (std_msgs/msg/String), /left" in refusal(path, "/middle")
    assert "/chatter is of type std_msgs/msg/String" in refusal(path, "/chatter")
    assert "no topic of type sensor_msgs/PointCloud2; it has /chatter" in refusal(write([]))


def test_an_unknown_definition_is_refused(tmp_path: Path):
    with Writer1(tmp_path / "a.bag") as writer:
        connection = writer.add_connection("/points", CLOUD, msgdef="float32[] values\n", md5sum="0" * 32)
        writer.write(connection, EPOCH_NS, b"\0" * 16)
    assert "definition of sensor_msgs/msg/PointCloud2 of its own" in refusal(tmp_path / "a.bag")
    for storage in StoragePlugin:
        with Writer2(tmp_path / storage.name, version=9, storage_plugin=storage) as writer2:
            connection = writer2.add_connection("/points", CLOUD, msgdef="float32[] values\n", rihs01="RIHS01_0")
            writer2.write(connection, EPOCH_NS, b"\0" * 16)
        assert "definition of sensor_msgs/msg/PointCloud2 of its own" in refusal(tmp_path / storage.name)


def test_a_long_name_of_a_topic_is_said_in_short(tmp_path: Path):
    with Writer1(tmp_path / "a.bag") as writer:
        connection = writer.add_connection("/" + "p" * 5000, CLOUD, msgdef="float32[] values\n", md5sum="0" * 32)
        writer.write(connection, EPOCH_NS, b"\0" * 16)
    assert len(refusal(tmp_path / "a.bag")) < 1000
    assert len(refusal(tmp_path / "a.bag", "/" + "p" * 5000)) < 1000


def test_a_bag_that_was_not_closed_is_read(tmp_path: Path):
    path = write_bag2(tmp_path / "a", {"/points": SCANS})
    (path / "metadata.yaml").unlink()
    bag = open_scans(path)
    assert_same(bag, range(10))
    assert bag.notes == ()


@pytest.mark.parametrize(
    ("form", "file", "share"),
    [
        ("ros 1", "", 0.55),
        ("ros 1 lz4", "", 0.55),
        ("ros 1 bz2", "", 0.8),
        ("sqlite", "a.db3", 0.55),
        ("sqlite file", "", 0.55),
        ("mcap bag", "a.mcap", 0.55),
        ("mcap file", "", 0.55),
        ("mcap zstd", "", 0.99),
    ],
)
def test_of_a_bag_that_is_cut_off_what_is_whole_is_used(
    form: str, file: str, share: float, tmp_path: Path, monkeypatch
):
    many = [SCANS[i % 10] for i in range(60)]
    monkeypatch.setattr("tests.lidar.test_bag.SCANS", many)
    path = BAGS[form](tmp_path)
    damaged = path / file if file else path
    content = damaged.read_bytes()
    damaged.write_bytes(content[: int(share * len(content))])
    bag = open_scans(path)
    assert 0.3 * share * 60 < len(bag) <= 60
    assert_same(bag, range(len(bag)))
    assert_same(bag, [1, len(bag) - 1])
    assert f"the {len(bag)} whole messages of /points are used" in bag.notes[0]
    if file:
        assert f"{60 - len(bag)} are lost" in bag.notes[0]


def test_a_damaged_message_is_counted_and_named(tmp_path: Path):
    with Writer2(tmp_path / "a", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/points", CLOUD, typestore=ROS2)
        for i in range(10):
            stamp = EPOCH_NS + i * PERIOD_NS
            data = bytes(ROS2.serialize_cdr(cloud_message(SCANS[i], stamp, ros1=False), CLOUD))
            writer.write(connection, stamp, data[: len(data) // 2] if i == 4 else data)
    bag = open_scans(tmp_path / "a")
    assert [scan is None for scan in bag.read(range(10), 2)] == [i == 4 for i in range(10)]
    assert list(bag.skipped) == ["scan 4"]


def test_rows_with_padding_and_messages_that_promise_too_much(tmp_path: Path):
    message = cloud_message(SCANS[0], EPOCH_NS, ros1=True)
    rows = records_of(SCANS[0]).view(np.uint8).reshape(20, -1)
    padded = np.pad(rows, ((0, 0), (0, 12)))
    with Writer1(tmp_path / "a.bag") as writer:
        connection = writer.add_connection("/points", CLOUD, typestore=ROS1)
        for i in range(6):
            message.header.stamp.nanosec = i * PERIOD_NS
            message.height, message.width, message.row_step, message.data = 20, 100, padded.shape[1], padded.ravel()
            if i == 3:
                message.height = 10**9
            writer.write(connection, EPOCH_NS + i * PERIOD_NS, ROS1.serialize_ros1(message, CLOUD))
    scans = list(open_scans(tmp_path / "a.bag").read(range(6), 1))
    assert [scan is None for scan in scans] == [i == 3 for i in range(6)]
    assert scans[0] is not None
    np.testing.assert_array_equal(scans[0].points, xyz_of(SCANS[0]))


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
def test_a_file_that_is_no_bag(suffix: str, tmp_path: Path):
    for content in (b"", b"hello", b"#ROSBAG V1.2\n"):
        (tmp_path / f"a{suffix}").write_bytes(content)
        refusal(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("form", ["ros 1", "ros 1 lz4", "sqlite file", "mcap file", "mcap zstd"])
def test_damaged_bags_are_read_or_refused(form: str, tmp_path: Path, monkeypatch):
    monkeypatch.setattr("tests.lidar.test_bag.SCANS", [scene(seed, 20) for seed in range(3)])
    path = BAGS[form](tmp_path)
    whole = path.read_bytes()

    def read_all() -> None:
        bag = open_scans(path)
        list(bag.read(range(len(bag)), 1))

    @settings(fuzz, max_examples=30)
    @given(mutations(whole))
    def damaged(content: bytes) -> None:
        path.write_bytes(content)
        read_or_refused(read_all, ScanError)

    damaged()
