from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from laci_stereo.core.errors import CamError
from laci_stereo.io.cam.log import read_cam_log
from tests.io import cam_writers as writers
from tests.io.cam.test_cam_log import assert_same_track, refusal
from tests.io.cam_writers import (
    CAM_TYPE,
    ROS2,
    drive,
    received,
    ros_cams,
    ros_fixes,
    ros_values,
    write_bag1,
    write_bag2,
)

LOG = drive(20)


def test_all_topics_with_messages_are_read(tmp_path: Path):
    sent = ros_cams(LOG)["/v2x/cam"][1]
    own = drive(20, station=7, latitude=48.43)
    topics = {"/rx/cam": (CAM_TYPE, sent), "/tx/cam": ros_cams(own)["/v2x/cam"], **ros_fixes(LOG)}
    for path in (write_bag1(tmp_path / "a.bag", topics), write_bag2(tmp_path / "b", topics)):
        recording = read_cam_log(path)
        assert_same_track(recording.log.of(3725855973), LOG)
        assert_same_track(recording.log.of(7), own)
        assert recording.notes[0] == "topics read: /rx/cam, /tx/cam; 1 others left out"


def test_roadside_units_are_left_out(tmp_path: Path):
    sent = [(ns, ros_values(LOG, i, choice=int(i >= 15))) for i, ns in enumerate(received(LOG))]
    recording = read_cam_log(write_bag2(tmp_path / "a", {"/cam": (CAM_TYPE, sent)}))
    assert len(recording.log) == 15
    assert any("left out: 5 x CAM of a roadside unit" in note for note in recording.notes)


def test_another_definition_is_refused(tmp_path: Path):
    told = writers.definition().replace("uint8 protocol_version", "uint16 protocol_version")
    said = refusal(write_bag2(tmp_path / "a", ros_cams(LOG), told=told))
    assert "definition of etsi_its_cam_msgs/msg/CAM of its own: element 1 is uint16; needed is uint8" in said
    levels = ["\n".join(f"a_msgs/T{i} a{k}" for k in range(30)) for i in range(12)]
    named = [f"{'=' * 80}\nMSG: a_msgs/T{i}\n{text}" for i, text in enumerate([*levels[1:], "uint8 X=1"])]
    wide = "\n".join([levels[0], *named]) + "\n"
    assert "element 1 is missing" in refusal(write_bag2(tmp_path / "c", ros_cams(LOG), told=wide))
    assert "element 1 is itself" in refusal(write_bag2(tmp_path / "d", ros_cams(LOG), told="CAM cam\n"))
    assert "cannot be read" in refusal(write_bag2(tmp_path / "b", ros_cams(LOG), told="Nothing of_the_kind\n"))


def test_fixes_without_a_position_are_left_out(tmp_path: Path):
    name, sent = ros_fixes(LOG)["/gps/fix"]
    lost = [
        (ns, {**values, "status": {"status": -1 if i < 4 else 0, "service": 1}}) for i, (ns, values) in enumerate(sent)
    ]
    recording = read_cam_log(write_bag2(tmp_path / "a", {"/gps/fix": (name, lost)}))
    assert len(recording.log) == 16
    assert "4 messages without a fix left out" in recording.notes
    np.testing.assert_allclose(recording.log.semi_major_95_m, 0.2 * 2.4477)
    np.testing.assert_allclose(recording.log.ellipse_orientation_deg, 90.0)


def test_what_a_bag_lacks_is_told(tmp_path: Path):
    name, sent = ros_fixes(LOG)["/gps/fix"]
    assert "has 2 topics with fixes: /a, /b" in refusal(
        write_bag2(tmp_path / "a", {"/a": (name, sent), "/b": (name, sent)})
    )
    text = {"/chatter": ("std_msgs/msg/String", [(received(LOG)[0], {"data": "hello"})])}
    assert "is a bag with the topics /chatter (std_msgs/msg/String)" in refusal(write_bag2(tmp_path / "b", text))
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    odometry = {
        "header": sent[0][1]["header"],
        "child_frame_id": "base",
        "pose": {"pose": {"position": zero, "orientation": {**zero, "w": 1.0}}, "covariance": np.zeros(36)},
        "twist": {"twist": {"linear": zero, "angular": zero}, "covariance": np.zeros(36)},
    }
    path = write_bag2(tmp_path / "c", {"/odom": ("nav_msgs/msg/Odometry", [(received(LOG)[0], odometry)])})
    assert "odometry on /odom, whose frame a bag does not tie to UTM" in refusal(path)


def test_of_a_bag_that_is_cut_off_what_is_whole_is_used(tmp_path: Path):
    log = drive(600, turn_deg_s=0.1)
    path = write_bag2(tmp_path / "a", ros_cams(log), "SQLITE3") / "a.db3"
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 6 // 10])
    recording = read_cam_log(path)
    assert 100 < len(recording.log) < 500
    assert_same_track(recording.log, log[np.arange(600) < len(recording.log)])
    assert any(f"the {len(recording.log)} whole messages are used" in note for note in recording.notes)


def test_without_the_extra_it_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = write_bag1(tmp_path / "a.bag", ros_cams(LOG))
    for name in ("laci_stereo.io.cam.bag_log", "laci_stereo.io.bag.files", "laci_stereo.io.bag.records"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    for name in ("rosbags.rosbag1", "rosbags.rosbag2", "rosbags.interfaces", "rosbags.typesys"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(CamError, match=r"pip install 'laci-stereo\[bag\]'"):
        read_cam_log(path)


def test_big_endian_messages(tmp_path: Path):
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    with Writer2(tmp_path / "a", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/cam", CAM_TYPE, msgdef=writers.definition(), rihs01="RIHS01_0")
        for i, ns in enumerate(received(LOG)):
            message = writers.ros_message(ROS2, CAM_TYPE, ros_values(LOG, i))
            writer.write(connection, ns, ROS2.serialize_cdr(message, CAM_TYPE, little_endian=False))
    assert_same_track(read_cam_log(tmp_path / "a").log, LOG)
