from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.core.messages.cam import CamLog
from laci_stereo.io.cam.direction import turned_back
from laci_stereo.io.cam.etsi import UNKNOWN
from laci_stereo.io.cam.its_time import ITS_EPOCH_NS
from laci_stereo.io.cam.received import Packet, Source, read_received

METRES_PER_DEG = 111_195.0


def straight(course_deg: float, heading_deg: float, speed_mps: float = 2.0, n: int = 20) -> CamLog:
    """Return the messages of a vehicle that moves one way and heads another."""
    m = 0.5 * speed_mps * np.arange(n)
    course, unknown = np.radians(course_deg), np.full(n, np.nan)
    return CamLog(
        stamps_ns=1_760_000_000_000_000_000 + 500_000_000 * np.arange(n),
        station_id=np.full(n, 7),
        latitude_deg=48.4 + m * np.cos(course) / METRES_PER_DEG,
        longitude_deg=9.9 + m * np.sin(course) / METRES_PER_DEG / np.cos(np.radians(48.4)),
        heading_deg=np.full(n, heading_deg % 360.0),
        speed_mps=np.full(n, speed_mps),
        altitude_m=unknown,
        length_m=unknown,
        width_m=unknown,
        semi_major_95_m=unknown,
        semi_minor_95_m=unknown,
        ellipse_orientation_deg=unknown,
    )


EVERY = np.ones(20, dtype=bool)


@given(st.floats(0.0, 359.0), st.floats(-30.0, 30.0), st.permutations(range(20)))
def test_backwards_the_body_points_the_other_way_than_the_motion(course: float, off: float, order: list[int]) -> None:
    log = straight(course, course + off)[np.array(order)]
    turned, (note,) = turned_back(log, EVERY)
    assert turned.heading_deg == pytest.approx((log.heading_deg + 180.0) % 360.0)
    assert note.startswith(
        "station 7: 20 messages with driveDirection backward: their headings are those of the motion"
    )
    # A heading of the body stays: turning twice is turning once.
    again, (note,) = turned_back(turned, EVERY)
    assert np.array_equal(again.heading_deg, turned.heading_deg)
    assert note.endswith("their headings are the body's")


def test_only_messages_that_say_so_are_turned() -> None:
    log = straight(30.0, 30.0)
    back = np.arange(20) >= 12
    turned, _ = turned_back(log, back)
    assert turned.heading_deg == pytest.approx(np.where(back, 210.0, 30.0))
    assert turned_back(log, ~EVERY)[1] == []


def test_nobody_reverses_fast() -> None:
    log = straight(30.0, 30.0, speed_mps=8.0)
    turned, (note,) = turned_back(log, EVERY)
    assert np.array_equal(turned.heading_deg, log.heading_deg)
    assert note.endswith("at 8.0 m/s: not believed, needed are at most 4 m/s")


def test_packets_of_a_vehicle_that_reverses_are_turned_too() -> None:
    log = straight(30.0, 30.0)
    cams = [
        UNKNOWN._replace(
            station_id=7,
            delta_ms=int(stamp_ns - ITS_EPOCH_NS) // 10**6 % 65536,
            latitude=round(1e7 * latitude),
            longitude=round(1e7 * longitude),
            heading=300,
            speed=200,
            drive_direction=1,
        )
        for stamp_ns, latitude, longitude in zip(log.stamps_ns, log.latitude_deg, log.longitude_deg, strict=True)
    ]
    packets = [Packet(i, cam, int(log.stamps_ns[i])) for i, cam in enumerate(cams)]
    recording = read_received(Source(Path("log.pcap"), "packet", "pcap"), packets)
    assert recording.log.heading_deg == pytest.approx(np.full(20, 210.0))
    assert any("20 messages with driveDirection backward" in note for note in recording.notes)


def test_what_is_not_known_is_not_turned() -> None:
    log = straight(30.0, 30.0)
    some = replace(log, heading_deg=np.where(np.arange(20) < 5, np.nan, log.heading_deg))
    assert np.isnan(turned_back(some, EVERY)[0].heading_deg).sum() == 5
    nowhere = replace(log, latitude_deg=np.full(20, np.nan), speed_mps=np.full(20, np.nan))
    assert np.array_equal(turned_back(nowhere, EVERY)[0].heading_deg, log.heading_deg)
