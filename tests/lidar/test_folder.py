from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from laci_lidar.errors import ScanError
from laci_lidar.folder import ScanFolder
from laci_lidar.scans import open_scans

from tests.lidar.support import (
    EPOCH_NS,
    PERIOD_NS,
    refusal,
    scene,
    write_bag1,
    write_folder,
    write_npy,
    write_pcd,
    xyz_of,
)

SCANS = [scene(seed, 50) for seed in range(8)]


def test_scans_come_in_the_order_of_time_whatever_their_names(tmp_path: Path):
    for i in (9, 10, 8):
        write_pcd(tmp_path / f"{i}.{i:09d}_cloud.pcd", SCANS[i - 8])
    (tmp_path / "timestamps.txt").write_text(
        "10.000000010_cloud.pcd 1760000000.0\n8.000000008_cloud.pcd 1760000000.2\n9.000000009_cloud.pcd 1760000000.1\n"
    )
    (tmp_path / "notes.md").write_text("no scan")
    (tmp_path / ".hidden.pcd").write_bytes(b"")
    folder = ScanFolder.open(tmp_path)
    assert (folder.stamps_ns - EPOCH_NS).tolist() == [0, PERIOD_NS, 2 * PERIOD_NS]
    for scan, i in zip(folder.read(range(3), 2), (2, 1, 0), strict=True):
        assert scan is not None
        np.testing.assert_array_equal(scan.points, xyz_of(SCANS[i]))


def test_it_is_read_as_often_as_it_is_asked_for(tmp_path: Path):
    folder = open_scans(write_folder(tmp_path / "scans", SCANS))
    first, again = ([scan.points for scan in folder.read([1, 4], 1) if scan is not None] for _ in range(2))
    for a, b, i in zip(first, again, (1, 4), strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(a, xyz_of(SCANS[i]))


def test_a_bad_scan_is_counted_and_named_once(tmp_path: Path):
    folder = ScanFolder.open(write_folder(tmp_path / "scans", SCANS))
    folder.files[3].write_bytes(folder.files[3].read_bytes()[:300])
    for _ in range(2):
        scans = list(folder.read(range(8), 2))
        assert [scan is None for scan in scans] == [i == 3 for i in range(8)]
    assert list(folder.skipped) == [folder.files[3].name]
    assert "cut off" in folder.skipped[folder.files[3].name]


def test_more_than_a_fifth_bad_scans_are_an_error(tmp_path: Path):
    folder = ScanFolder.open(write_folder(tmp_path / "scans", SCANS))
    for i in (3, 5):
        folder.files[i].write_bytes(b"")
    with pytest.raises(ScanError, match="2 of 8 scans are unusable; needed are at least 80% usable; the first: "):
        list(folder.read(range(8), 2))


def test_times_of_points_count_from_the_stamp_of_their_file(tmp_path: Path):
    (tmp_path / "scans").mkdir()
    for i in range(3):
        stamp = EPOCH_NS + i * PERIOD_NS
        columns = SCANS[i] | {"t": stamp / 1e9 + SCANS[i]["t"] / 1e9 - 0.05}
        write_pcd(tmp_path / f"scans/{stamp}.pcd", columns)
    for scan, columns in zip(open_scans(tmp_path / "scans").read(range(3), 1), SCANS, strict=False):
        assert scan is not None
        assert scan.offset_s is not None
        np.testing.assert_allclose(scan.offset_s, columns["t"] / 1e9 - 0.05, atol=1e-6)


def test_what_is_no_folder_of_scans(tmp_path: Path):
    assert "does not exist" in refusal(tmp_path / "missing")
    (tmp_path / "file.txt").write_text("hello")
    assert "is a file" in refusal(tmp_path / "file.txt")
    (tmp_path / "empty").mkdir()
    assert "empty is empty; needed are scans" in refusal(tmp_path / "empty")
    assert "holds 2 files but no scan" in refusal(tmp_path)
    assert "is a single scan" in refusal(write_pcd(tmp_path / "1760000000.pcd", SCANS[0]))
    assert "has no topic '/points'" in refusal(write_folder(tmp_path / "scans", SCANS), "/points")
    write_npy(tmp_path / "scans" / "1760000009.npy", SCANS[0])
    assert "holds 8 PCD and 1 npy files" in refusal(tmp_path / "scans")
    write_pcd(tmp_path / "empty" / "a.pcd", SCANS[0])
    assert "holds no time" in refusal(tmp_path / "empty")


def test_what_a_scanner_sent_is_named_as_that(tmp_path: Path):
    """A capture is what most scanners' viewers record."""
    (tmp_path / "raw").mkdir()
    for path, content in ((tmp_path / "drive.cap", b"\xd4\xc3\xb2\xa1"), (tmp_path / "raw/1.pcapng", b"\n\r\r\n")):
        path.write_bytes(content + bytes(40))
        for each in {path, path.parent} - {tmp_path}:
            assert "is a packet capture of a scanner" in refusal(each)


def test_two_scans_of_one_time(tmp_path: Path):
    for name in ("1760000000.0.pcd", "1760000000.00.pcd"):
        write_pcd(tmp_path / name, SCANS[0])
    assert "have the same time" in refusal(tmp_path)


def test_without_the_extra_for_bags_it_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = write_bag1(tmp_path / "a.bag", {"/points": SCANS})
    for name in (
        *("laci_lidar.bag", "laci_lidar.pointcloud2"),
        *("laci_stereo.io.bag.files", "laci_stereo.io.bag.records"),
    ):
        monkeypatch.delitem(sys.modules, name, raising=False)
    for name in ("rosbags.rosbag1", "rosbags.rosbag2", "rosbags.interfaces", "rosbags.typesys"):
        monkeypatch.setitem(sys.modules, name, None)
    assert "pip install 'laci-stereo[bag]'" in refusal(path)
