from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from datetime import datetime, timezone
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.core.errors import CamError
from laci_stereo.core.messages.cam import CamLog
from laci_stereo.io.cam.csv_log import read_cam_csv
from laci_stereo.io.cam.recording import CamRecording
from tests.io.support import SHARED, fuzz, mutations, needs_shared, noise, read_or_refused

START_NS = 1760000002_237000000
PERIOD_NS = 100_000_000
METRES_PER_DEG = 111_195.0


@dataclass(frozen=True)
class Message:
    """What one message says, in the units of the canonical columns."""

    ns: int
    latitude: float
    longitude: float
    heading: float
    speed: float
    station: int = 4711
    length: float = 4.7
    width: float = 1.8
    altitude: float = 560.25


def drive(n: int = 20, heading: float = 75.3, speed: float = 12.5, latitude: float = 48.4226) -> list[Message]:
    """Return messages of a vehicle that drives straight ahead."""
    steps = np.arange(n) * PERIOD_NS / 1e9 * speed / METRES_PER_DEG
    north, east = np.cos(np.radians(heading)), np.sin(np.radians(heading)) / np.cos(np.radians(latitude))
    return [
        Message(START_NS + i * PERIOD_NS, latitude + step * north, 9.9434 + step * east, heading, speed)
        for i, step in enumerate(steps)
    ]


def seconds(ns: int) -> str:
    return f"{ns // 10**9}.{ns % 10**9:09d}"


CANONICAL: dict[str, Callable[[Message], str]] = {
    "timestamp": lambda m: seconds(m.ns),
    "station_id": lambda m: str(m.station),
    "latitude": lambda m: f"{m.latitude:.7f}",
    "longitude": lambda m: f"{m.longitude:.7f}",
    "heading": lambda m: f"{m.heading:.1f}",
    "speed": lambda m: f"{m.speed:.2f}",
    "vehicle_length": lambda m: f"{m.length:.1f}",
    "vehicle_width": lambda m: f"{m.width:.1f}",
    "altitude": lambda m: f"{m.altitude:.2f}",
}
RAW: dict[str, Callable[[Message], str]] = {
    "timestamp": lambda m: str(m.ns // 10**6),
    "station_id": lambda m: str(m.station),
    "latitude": lambda m: str(round(m.latitude * 1e7)),
    "longitude": lambda m: str(round(m.longitude * 1e7)),
    "heading": lambda m: str(round(m.heading * 10)),
    "speed": lambda m: str(round(m.speed * 100)),
    "vehicle_length": lambda m: str(round(m.length * 10)),
    "vehicle_width": lambda m: str(round(m.width * 10)),
    "altitude": lambda m: str(round(m.altitude * 100)),
}
Columns = dict[str, Callable[[Message], str]]


def table(messages: list[Message], columns: Columns = CANONICAL) -> list[list[str]]:
    return [list(columns), *([cell(message) for cell in columns.values()] for message in messages)]


def write(path: Path, rows: list[list[str]], separator: str = ",", encoding: str = "utf-8") -> Path:
    path.write_text("\n".join(separator.join(row) for row in rows) + "\n", encoding=encoding)
    return path


def put(rows: list[list[str]], column: str, value: str, count: int) -> list[list[str]]:
    """Return a table with a value in the first rows of a column."""
    place = rows[0].index(column)
    return [[*row[:place], value, *row[place + 1 :]] if 0 < i <= count else row for i, row in enumerate(rows)]


def assert_same(found: CamLog, wanted: CamLog) -> None:
    for field in fields(CamLog):
        np.testing.assert_array_equal(getattr(found, field.name), getattr(wanted, field.name), field.name)


Read = Callable[..., CamRecording]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    """Write a table to cam.csv, with the further arguments of `write`, and read it."""
    return lambda rows, *how: read_cam_csv(write(tmp_path / "cam.csv", rows, *how))


@pytest.fixture
def log(read: Read) -> CamLog:
    return read(table(drive())).log


def test_canonical_columns_need_no_interpretation(read: Read) -> None:
    recording = read(table(drive()))
    assert recording.notes == ()
    log = recording.log
    assert log.stamps_ns.dtype == log.station_id.dtype == np.int64
    assert log.stamps_ns.tolist() == [message.ns for message in drive()]
    np.testing.assert_allclose(log.latitude_deg, [message.latitude for message in drive()], rtol=0, atol=5.1e-8)
    np.testing.assert_allclose(log.longitude_deg, [message.longitude for message in drive()], rtol=0, atol=5.1e-8)
    values = (log.heading_deg, log.speed_mps, log.length_m, log.width_m, log.altitude_m)
    assert [set(found.tolist()) for found in values] == [{75.3}, {12.5}, {4.7}, {1.8}, {560.25}]
    assert np.isnan(log.semi_major_95_m).all()


@pytest.mark.parametrize("separator", [";", "\t"])
def test_decimal_commas_are_read_as_points(read: Read, separator: str) -> None:
    commas = [[cell.replace(".", ",") for cell in row] for row in table(drive())]
    recording = read(commas, separator)
    assert recording.notes == ()
    assert_same(recording.log, read(table(drive())).log)


def its_delta_ms(message: Message) -> int:
    """Return the message's time on ETSI's clock, which counts the five leap seconds since 2004, modulo 65,536 ms."""
    return (message.ns // 10**6 - 1_072_915_200_000 + 5_000) % 65_536


@pytest.mark.parametrize("shift_s", [0, 30, 60])
def test_a_message_is_of_its_generation_not_of_its_reception(read: Read, shift_s: int) -> None:
    sent = [replace(message, ns=message.ns // 10**6 * 10**6 + shift_s * 10**9) for message in drive(400)]
    late_ms = np.random.default_rng(shift_s).integers(20, 120, len(sent))
    rows = table(sent, {**CANONICAL, "generationDeltaTime": lambda m: str(its_delta_ms(m))})
    received = [seconds(message.ns + int(late) * 10**6) for message, late in zip(sent, late_ms, strict=True)]
    rows[1:] = [[stamp, *row[1:]] for stamp, row in zip(received, rows[1:], strict=True)]
    recording = read(rows)
    assert recording.log.stamps_ns.tolist() == [message.ns for message in sent]
    assert any("generationDeltaTime, of which 65.536 s the time of reception tells" in note for note in recording.notes)


def test_seconds_of_a_gps_week_are_refused_with_what_they_lack(read: Read) -> None:
    gps_s = START_NS // 10**9 - 315_964_782
    in_week = [
        replace(message, ns=message.ns - (315_964_782 + gps_s // 604_800 * 604_800) * 10**9) for message in drive()
    ]
    with pytest.raises(CamError) as refused:
        read(table(in_week))
    first_s, week_s = map(
        int, re.findall(r"(\d+) s, and (\d+) s for each week since 1980-01-06", str(refused.value))[0]
    )
    mended_s = in_week[0].ns // 10**9 + first_s + gps_s // 604_800 * week_s
    assert mended_s == START_NS // 10**9


@pytest.mark.parametrize("milliseconds", [False, True])
def test_times_of_another_epoch_are_remarked(read: Read, milliseconds: bool) -> None:
    behind = [replace(message, ns=message.ns - 1_072_915_195 * 10**9) for message in drive()]
    title, stamp = (
        ("timestamp_ms", lambda m: str(m.ns // 10**6)) if milliseconds else ("timestamp", CANONICAL["timestamp"])
    )
    columns = {title: stamp, **{name: text for name, text in CANONICAL.items() if name != "timestamp"}}
    (note,) = [n for n in read(table(behind, columns)).notes if "the times" in n]
    assert "the times are of 1991-10-10" in note
    assert "from ETSI's epoch, 2004-01-01, they are of 2025-10-09: add 1072915195 s to them" in note


@pytest.mark.parametrize("other_m", [4.8, 12.0])
def test_a_vehicle_that_changes_its_length_is_remarked(read: Read, other_m: float) -> None:
    sent = [replace(message, length=(4.7, other_m)[i % 2]) for i, message in enumerate(drive())]
    steady = [replace(message, station=4712, length=9.9) for message in drive()]
    changing = read(table([*sent, *steady]))
    (note,) = changing.notes[-1:]
    assert note.startswith(f"station 4711 changes its vehicle_length 19 times, between 4.70 and {other_m:.2f} m: the")
    assert "4712" not in note
    assert not any("changes" in each for each in read(table(steady)).notes)


@pytest.mark.parametrize("filled", ["0", "", "70000", "1.5"])
def test_a_generation_time_that_was_not_filled_in_is_not_used(read: Read, filled: str) -> None:
    rows = table(drive(), {**CANONICAL, "generation_delta_time": lambda m: filled})
    recording = read(rows)
    assert recording.log.stamps_ns.tolist() == [message.ns for message in drive()]
    assert any(note.startswith("generationDeltaTime is not used") for note in recording.notes)


MESSAGES = st.lists(
    st.builds(
        Message,
        ns=st.integers(10**17, 4 * 10**18),
        latitude=st.integers(-899999999, 899999999).map(lambda raw: raw / 1e7),
        longitude=st.integers(-1799999999, 1799999999).map(lambda raw: raw / 1e7),
        heading=st.integers(0, 3599).map(lambda raw: raw / 10),
        speed=st.integers(0, 12000).map(lambda raw: raw / 100),
        station=st.integers(0, 2**63 - 1),
        length=st.integers(10, 600).map(lambda raw: raw / 10),
        width=st.integers(5, 61).map(lambda raw: raw / 10),
        altitude=st.integers(-10000, 800000).map(lambda raw: raw / 100),
    ),
    min_size=1,
    max_size=6,
    unique_by=lambda message: message.ns,
)


@fuzz
@given(MESSAGES, st.sampled_from(",;\t"), st.sampled_from(["utf-8", "utf-8-sig"]))
def test_every_number_comes_back_exactly(read: Read, messages: list[Message], separator: str, encoding: str) -> None:
    exact: Columns = {**CANONICAL, "latitude": lambda m: repr(m.latitude), "longitude": lambda m: repr(m.longitude)}
    # One position off the integers keeps degrees from being taken for 1e-7 of them.
    messages = [replace(messages[0], latitude=48.42265, longitude=9.94345), *messages[1:]]
    log = read(table(messages, exact), separator, encoding).log
    by_stamp = {message.ns: message for message in messages}
    assert sorted(by_stamp) == log.stamps_ns.tolist()
    for i, ns in enumerate(log.stamps_ns.tolist()):
        message = by_stamp[ns]
        assert log.station_id[i] == message.station
        assert (log.heading_deg[i], log.speed_mps[i], log.length_m[i]) == (
            message.heading,
            message.speed,
            message.length,
        )
        if max(abs(message.latitude), abs(message.longitude)) > 1e-4:
            assert (log.latitude_deg[i], log.longitude_deg[i]) == (message.latitude, message.longitude)


@pytest.mark.parametrize(
    "stamp",
    [
        lambda ns: str(ns),
        lambda ns: str(ns // 10**3),
        lambda ns: str(ns // 10**6),
        lambda ns: f"{ns // 10**6 / 1e3:.3f}",
        lambda ns: f"{ns / 1e9:.12e}",
        lambda ns: f"{datetime.fromtimestamp(ns // 10**9, timezone.utc):%Y-%m-%dT%H:%M:%S}.{ns % 10**9:09d}Z",
        lambda ns: (
            f"{datetime.fromtimestamp(ns // 10**9 + 7200, timezone.utc):%Y-%m-%d %H:%M:%S}.{ns % 10**9:09d}+02:00"
        ),
        lambda ns: f"{datetime.fromtimestamp(ns // 10**9, timezone.utc):%Y-%m-%dT%H:%M:%S}.{ns % 10**9 // 10**6:03d}",
    ],
)
def test_times_in_their_ways(read: Read, log: CamLog, stamp: Callable[[int], str]) -> None:
    columns: Columns = {**CANONICAL, "timestamp": lambda m: stamp(m.ns)}
    assert_same(read(table(drive(), columns)).log, log)


@pytest.mark.parametrize("digits", [9, 6, 3])
def test_parts_of_seconds_without_their_zeros_are_known_by_the_order_of_the_rows(
    read: Read, log: CamLog, digits: int
) -> None:
    unit = 10 ** (9 - digits)
    stamps = {"timestamp": lambda m: f"{m.ns // 10**9}.{m.ns % 10**9 // unit}"}
    recording = read(table(drive(), CANONICAL | stamps))
    assert_same(recording.log, log)
    padded = "timestamp: parts of seconds without leading zeros behind the point, by the order of the rows"
    assert padded in recording.notes


def test_decimal_seconds_out_of_order_stay_decimal(read: Read, log: CamLog) -> None:
    head, *rows = table(drive(), CANONICAL | {"timestamp": lambda m: seconds(m.ns).rstrip("0")})
    recording = read([head, *rows[5:], *rows[:5]])
    assert_same(recording.log, log)


def iso_parts(m: Message) -> tuple[str, str]:
    day, time = datetime.fromtimestamp(m.ns // 10**9, timezone.utc).strftime("%Y-%m-%d %H:%M:%S").split()
    return day, f"{time}.{m.ns % 10**9:09d}"


@pytest.mark.parametrize(
    "columns",
    [
        {"header.stamp.sec": lambda m: str(m.ns // 10**9), "header.stamp.nanosec": lambda m: str(m.ns % 10**9)},
        {"sec": lambda m: str(m.ns // 10**9), "nsec": lambda m: str(m.ns % 10**9)},
        {"Date": lambda m: iso_parts(m)[0], "Time": lambda m: iso_parts(m)[1] + "Z"},
        {"UTC time": lambda m: iso_parts(m)[1] + "Z", "date": lambda m: iso_parts(m)[0].replace("-", "/")},
    ],
)
def test_a_time_in_two_columns(read: Read, log: CamLog, columns: Columns) -> None:
    others = {title: cell for title, cell in CANONICAL.items() if title != "timestamp"}
    assert_same(read(table(drive(), columns | others)).log, log)


def of_week(m: Message) -> tuple[int, int]:
    """Return the GPS week, and the nanoseconds in it."""
    since = datetime.fromtimestamp(m.ns // 10**9 + 18, timezone.utc) - datetime(1980, 1, 6, tzinfo=timezone.utc)
    return since.days // 7, ((since.days % 7) * 86_400 + since.seconds) * 10**9 + m.ns % 10**9


@pytest.mark.parametrize(
    ("titles", "unit_ns"),
    [
        (("week", "tow"), 10**9),
        (("GPS Week", "GPS TOW [s]"), 10**9),
        (("gps_week", "time_of_week"), 10**6),
        (("WNc", "iTOW"), 10**6),
    ],
)
def test_a_gps_week_and_the_time_in_it(read: Read, log: CamLog, titles: tuple[str, str], unit_ns: int) -> None:
    others = {title: cell for title, cell in CANONICAL.items() if title != "timestamp"}
    columns: Columns = {
        titles[0]: lambda m: str(of_week(m)[0]),
        titles[1]: lambda m: str(Decimal(of_week(m)[1]) / unit_ns),
    }
    recording = read(table(drive(), columns | others))
    assert_same(recording.log, log)
    assert recording.notes == ("timestamp: from the GPS week and the time in it, less the 18 leap seconds of UTC",)


def test_a_time_of_a_gps_week_needs_its_number(read: Read) -> None:
    head, *rows = table(drive())
    with pytest.raises(CamError, match=r"lacks the column timestamp.* \(beside 'TOW', needed is gps_week, the"):
        read([["TOW", *head[1:]], *rows])
    numbered = [["gps_week", "TOW", *head[1:]], *(["2.5", "4", *row[1:]] for row in rows)]
    with pytest.raises(CamError, match=r"row 2: timestamp is '2\.5 4'; needed is"):
        read(numbered)


def test_degrees_and_minutes_in_one_number_are_refused_with_the_remedy(read: Read) -> None:
    minutes = {"latitude": lambda m: f"{4800 + (m.latitude - 48) * 60:.5f}"}
    with pytest.raises(CamError, match=r"needed is -90 to 90 \(if these are degrees and minutes, as in NMEA, decimal"):
        read(table(drive(), CANONICAL | minutes))
    with pytest.raises(CamError, match=r"latitude is 4870 deg; needed is -90 to 90 \(20 of"):
        read(table(drive(), CANONICAL | {"latitude": lambda m: "4870.0"}))


@pytest.mark.parametrize("text", ["11/10/2026 12:00:00.5", "10-11-2026 12:00:00", "1/2/26 1:00:00.5 PM"])
def test_dates_whose_day_may_be_the_month_are_refused(read: Read, text: str) -> None:
    with pytest.raises(CamError, match=r"2025-10-09T08:53:22\.237Z, the year first: else the day may be the month"):
        read(table(drive(), CANONICAL | {"timestamp": lambda m: text}))


@pytest.mark.parametrize("end", ["", ".value"])
def test_titles_may_be_paths(read: Read, log: CamLog, end: str) -> None:
    titles = ("frame.time_epoch", "its.stationID", "its.latitude", "its.longitude", "cam.heading.headingValue")
    titles += ("its.speedValue", "its.vehicleLengthValue", "its.vehicleWidth", "a.b.altitudeValue")
    _, *rows = table(drive())
    assert_same(read([[titles[0], *(title + end for title in titles[1:])], *rows]).log, log)


def test_a_last_name_that_two_paths_share_is_not_guessed(read: Read) -> None:
    head, *rows = table(drive())
    paths = ["ego.latitude" if title == "latitude" else title for title in head]
    with pytest.raises(CamError, match=r"lacks the column latitude; .* ego\.latitude, .* rsu\.latitude"):
        read([[*paths, "rsu.latitude"], *([*row, "48.0"] for row in rows)])


@pytest.mark.parametrize(
    "head", [["sep=;"], ["# a log; of, Ulm", "# UTC"], ["# a log, of Ulm"], ["", "#", "# UTC", ""]], ids=str
)
@pytest.mark.parametrize("mark", ["", "# "])
def test_lines_before_the_header_are_left_out(tmp_path: Path, log: CamLog, head: list[str], mark: str) -> None:
    commas = [";".join(cell.replace(".", ",") for cell in row) for row in table(drive())]
    path = tmp_path / "cam.csv"
    path.write_text("\n".join([*head, mark + commas[0], *commas[1:]]))
    assert_same(read_cam_csv(path).log, log)
    path.write_text("\n".join([*head, *commas[:4], commas[4].replace("4711", "x"), *commas[5:]]))
    assert f"the first of them row {len(head) + 5}: station_id is 'x'" in read_cam_csv(path).notes[0]


def test_one_column_is_told_what_separates_columns(read: Read) -> None:
    with pytest.raises(CamError, match=r"it holds timestamp station_id .* as one column: needed are commas"):
        read(table(drive()), " ")


def test_numbers_of_rows_are_no_stations(read: Read) -> None:
    head, *rows = table(drive())
    numbered = [
        [str(i) if head[k] == "station_id" else cell for k, cell in enumerate(row)] for i, row in enumerate(rows)
    ]
    recording = read([[{"station_id": "id"}.get(t, t) for t in head], *numbered])
    assert set(recording.log.station_id.tolist()) == {0}
    assert "column id numbers the rows, so it is no station_id: all are of one station, 0" in recording.notes


def test_a_time_without_a_zone_is_noted(read: Read) -> None:
    columns: Columns = {
        **CANONICAL,
        "timestamp": lambda m: datetime.fromtimestamp(m.ns / 1e9, timezone.utc).isoformat()[:-6],
    }
    notes = read(table(drive(), columns)).notes
    assert notes == ("timestamp: 20 times without a zone, taken for UTC",)


@pytest.mark.parametrize(
    "titles",
    [
        "time,stationID,lat,lon,course,velocity,length,width,alt",
        "Unix Time,Station ID,Latitude,Longitude,Heading,Speed,Vehicle Length,Vehicle Width,Altitude",
        "ts,id,LAT,LNG,headingDeg,speed_mps,vehicleLength,vehicleWidth,altitude_m",
        "t,station,lat_deg,long,heading_deg,speed,vehicle_length_m,vehicle_width_m,elevation",
        "gpsTime,sender_id,latitudeDeg,longitude_deg,headingValue,speedValue,length_m,width_m,ele",
    ],
)
def test_synonyms_are_known_and_noted(read: Read, log: CamLog, titles: str) -> None:
    recording = read([titles.split(","), *table(drive())[1:]])
    assert_same(recording.log, log)
    assert f"column {titles.split(',')[0]} read as timestamp" in recording.notes


def test_the_canonical_column_goes_before_its_synonyms(read: Read, log: CamLog) -> None:
    rows = [["time", "lat", *titles] if i == 0 else ["1", "2", *titles] for i, titles in enumerate(table(drive()))]
    recording = read(rows)
    assert_same(recording.log, log)
    assert recording.notes == ()


def test_yaw_is_no_heading(read: Read) -> None:
    rows = table(drive())
    rows[0][rows[0].index("heading")] = "yaw"
    recording = read(rows)
    assert np.isnan(recording.log.heading_deg).all()
    assert recording.notes == ("no column heading; it follows from the positions",)


def test_raw_etsi_integers_are_recognised_and_noted(read: Read, log: CamLog) -> None:
    recording = read(table(drive(), RAW))
    assert_same(recording.log, log)
    assert "latitude: raw ETSI integers of 1e-7 deg" in recording.notes
    assert "heading: raw ETSI integers of 0.1 deg" in recording.notes
    assert "speed: raw ETSI integers of 0.01 m/s" in recording.notes
    assert "vehicle_length: raw ETSI integers of 0.1 m" in recording.notes
    assert "timestamp: Unix time in milliseconds" in recording.notes


def test_units_are_decided_for_the_file_and_not_for_each_value(read: Read) -> None:
    # Northwards the raw heading runs from 3590 over 0 to 10, a car that stops sends the speed 0.
    headings = [(359.0 + 0.1 * i) % 360 for i in range(21)]
    messages = [replace(drive()[0], ns=START_NS + i * PERIOD_NS, heading=h, speed=0.0) for i, h in enumerate(headings)]
    log = read(table(messages, RAW)).log
    np.testing.assert_allclose(log.heading_deg, headings, atol=1e-9)
    assert set(log.speed_mps.tolist()) == {0.0}


def test_columns_may_be_raw_while_others_are_not(read: Read, log: CamLog) -> None:
    names = ["heading", "speed", "vehicle_length", "vehicle_width"]
    degrees = read(table(drive(), {**CANONICAL, **{name: RAW[name] for name in names}}))
    assert_same(degrees.log, log)
    metres = read(table(drive(), {**RAW, **{name: CANONICAL[name] for name in names}}))
    assert_same(metres.log, log)


def test_whole_numbers_of_metres_and_degrees_are_no_raw_integers(read: Read) -> None:
    messages = [
        replace(message, heading=90.0, length=12.0, width=3.0, speed=12.0)
        for message in drive(heading=90.0, speed=12.0)
    ]
    whole: Columns = {
        **CANONICAL,
        "heading": lambda m: f"{m.heading:.0f}",
        "speed": lambda m: f"{m.speed:.0f}",
        "vehicle_length": lambda m: f"{m.length:.0f}",
        "vehicle_width": lambda m: f"{m.width:.0f}",
    }
    recording = read(table(messages, whole))
    log = recording.log
    assert (log.heading_deg[0], log.speed_mps[0], log.length_m[0], log.width_m[0]) == (90.0, 12.0, 12.0, 3.0)
    assert recording.notes == ()


@pytest.mark.parametrize(("length", "width", "speed"), [("12", "2.55", "6.00"), ("12.0", "3.0", "6.0")])
def test_what_is_written_with_a_decimal_point_is_not_raw_beside_raw_positions(
    read: Read, length: str, width: str, speed: str
) -> None:
    metres = {"speed": speed, "vehicle_length": length, "vehicle_width": width, "heading": "75.0"}
    columns: Columns = {**RAW, **{name: lambda m, text=text: text for name, text in metres.items()}}  # type: ignore[misc]
    log = read(table(drive(speed=6.0), columns)).log
    found = (log.speed_mps[0], log.length_m[0], log.width_m[0], log.heading_deg[0])
    assert found == tuple(map(float, (speed, length, width, "75.0")))


def test_length_and_width_are_of_one_unit_and_so_are_the_axes_of_an_ellipse(read: Read) -> None:
    columns: Columns = {**CANONICAL, "vehicle_length": lambda m: "47", "vehicle_width": lambda m: "18"}
    axes: Columns = {"semi_major": lambda m: "120", "semi_minor": lambda m: "90"}
    log = read(table(drive(), {**columns, **axes})).log
    assert (log.length_m[0], log.width_m[0], log.semi_major_95_m[0], log.semi_minor_95_m[0]) == (4.7, 1.8, 1.2, 0.9)


def test_points_behind_all_whole_numbers_tell_nothing(read: Read, log: CamLog) -> None:
    names = ["latitude", "longitude", "heading", "speed", "vehicle_length", "vehicle_width", "altitude"]
    rows = table(drive(), RAW)
    places = [rows[0].index(name) for name in names]
    rows[1:] = [[f"{cell}.0" if i in places else cell for i, cell in enumerate(row)] for row in rows[1:]]
    assert_same(read(rows).log, log)


@pytest.mark.parametrize("columns", [CANONICAL, RAW], ids=["degrees", "raw"])
@pytest.mark.parametrize(
    ("column", "code", "field"),
    [
        ("latitude", "900000001", "latitude_deg"),
        ("longitude", "1800000001", "longitude_deg"),
        ("altitude", "800001", "altitude_m"),
        ("heading", "3601", "heading_deg"),
        ("speed", "16383", "speed_mps"),
        ("vehicle_length", "1023", "length_m"),
        ("vehicle_width", "62", "width_m"),
    ],
)
def test_unavailable_is_missing(read: Read, columns: Columns, column: str, code: str, field: str) -> None:
    recording = read(put(table(drive(), columns), column, code, 3))
    values = getattr(recording.log, field)
    assert np.isnan(values).tolist() == [True] * 3 + [False] * 17
    assert f'{column}: 3 times {code}, ETSI\'s "unavailable"; taken as missing' in recording.notes


@pytest.mark.parametrize(
    ("column", "code", "field"),
    [
        ("latitude", "90.0000001", "latitude_deg"),
        ("heading", "360.1", "heading_deg"),
        ("speed", "163.83", "speed_mps"),
        ("vehicle_length", "102.3", "length_m"),
        ("vehicle_width", "6.2", "width_m"),
    ],
)
def test_unavailable_that_was_converted_along_is_missing_too(read: Read, column: str, code: str, field: str) -> None:
    log = read(put(table(drive()), column, code, 3)).log
    assert np.isnan(getattr(log, field)).tolist() == [True] * 3 + [False] * 17


def test_confidence_ellipses_are_read(read: Read) -> None:
    columns: Columns = {
        **RAW,
        "semiMajorConfidence": lambda m: "120",
        "semiMinorConfidence": lambda m: "4095",
        "semiMajorOrientation": lambda m: "905",
    }
    log = read(table(drive(), columns)).log
    assert set(log.semi_major_95_m.tolist()) == {1.2}
    assert set(log.ellipse_orientation_deg.tolist()) == {90.5}
    assert np.isnan(log.semi_minor_95_m).all()


@pytest.mark.parametrize(
    ("column", "code", "field"),
    [
        ("altitude", "800000", "altitude_m"),
        ("speed", "16382", "speed_mps"),
        ("vehicle_length", "1022", "length_m"),
        ("vehicle_width", "61", "width_m"),
    ],
)
def test_what_is_too_large_to_be_sent_is_missing(read: Read, column: str, code: str, field: str) -> None:
    columns: Columns = {**RAW, "semiMajorConfidence": lambda m: "120", "semiMinorConfidence": lambda m: "80"}
    recording = read(put(table(drive(), columns), column, code, 12))
    assert np.isnan(getattr(recording.log, field)).tolist() == [True] * 12 + [False] * 8
    assert any(f'12 times {code}, ETSI\'s "out of range"; taken as missing' in note for note in recording.notes)


@pytest.mark.parametrize("columns", [CANONICAL, RAW], ids=["degrees", "raw"])
@pytest.mark.parametrize("count", [12, 20])
def test_an_accuracy_that_is_too_large_to_be_sent_is_as_large_at_least(
    read: Read, columns: Columns, count: int
) -> None:
    """TS 102 894-2, SemiAxisLength: 4094 is more than 40.93 m, 4095 is unavailable."""
    axis = "1.2" if columns is CANONICAL else "120"
    columns = {**columns, "semiMajorConfidence": lambda m: axis, "semiMinorConfidence": lambda m: axis}
    rows = put(table(drive(), columns), "semiMajorConfidence", "4094", count)
    recording = read(put(rows, "semiMinorConfidence", "4095", 3))
    assert recording.log.semi_major_95_m.tolist() == [40.94] * count + [1.2] * (20 - count)
    assert np.isnan(recording.log.semi_minor_95_m).tolist() == [True] * 3 + [False] * 17
    assert any(f'{count} times 4094, ETSI\'s "out of range"; taken as 40.94 m' in note for note in recording.notes)


def test_no_position_is_exact(read: Read) -> None:
    columns: Columns = {**CANONICAL, "semi_major_95": lambda m: "0", "semi_minor_95": lambda m: "0.0"}
    log = read(table(drive(), columns)).log
    assert np.isnan(log.semi_major_95_m).all()
    assert np.isnan(log.semi_minor_95_m).all()


def test_rows_are_sorted_and_doubled_ones_merged(read: Read, log: CamLog) -> None:
    rows = table(drive())
    lacking = put([rows[0], rows[5]], "speed", "", 1)[1]
    shuffled = [rows[0], rows[7], *rows[1:5], lacking, *rows[6:7], *rows[8:], rows[5], rows[9], rows[9]]
    recording = read(shuffled)
    assert_same(recording.log, log)
    assert "9 rows out of order sorted" in recording.notes
    assert "3 doubled rows merged" in recording.notes


def test_the_same_time_from_two_stations_is_not_doubled(read: Read) -> None:
    messages = [replace(message, station=station) for message in drive() for station in (2**62, 7)]
    log = read(table(messages)).log
    assert len(log) == 40
    assert set(log.stations()) == {7, 2**62}


def test_times_in_whole_seconds_are_refused_rather_than_merged(read: Read) -> None:
    columns: Columns = {**CANONICAL, "timestamp": lambda m: str(m.ns // 10**9)}
    with pytest.raises(CamError, match=r"cam\.csv: timestamp and station_id are those of another row in 17 of 20 rows"):
        read(table(drive(), columns))


@pytest.mark.parametrize(
    ("column", "note"),
    [
        ("station_id", "no station_id; all rows are taken for those of one station, 0"),
        ("speed", "no column speed; it follows"),
        ("heading", "no column heading; it follows"),
    ],
)
def test_what_may_be_absent_is_noted(read: Read, column: str, note: str) -> None:
    columns = {name: cell for name, cell in CANONICAL.items() if name != column}
    recording = read(table(drive(), columns))
    assert any(found.startswith(note) for found in recording.notes)
    assert len(recording.log) == 20


@pytest.mark.parametrize("column", ["timestamp", "latitude", "longitude"])
def test_what_may_not_be_absent_is_named(read: Read, column: str) -> None:
    columns = {name: cell for name, cell in CANONICAL.items() if name != column}
    with pytest.raises(CamError, match=rf"cam\.csv lacks the column {column}; needed are .*, it holds .*station_id"):
        read(table(drive(), columns))


def test_dimensions_may_be_absent(read: Read) -> None:
    columns = {name: cell for name, cell in CANONICAL.items() if not name.startswith("vehicle_")}
    log = read(table(drive(), columns)).log
    assert np.isnan(log.length_m).all()
    assert np.isnan(log.width_m).all()


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("latitude", "north"),
        ("timestamp", "soon"),
        ("timestamp", ""),
        ("heading", "1,5x"),
        ("station_id", "car"),
        ("speed", "inf"),
    ],
)
def test_a_few_bad_rows_are_skipped_and_more_refused(read: Read, column: str, value: str) -> None:
    rows = put(table(drive()), column, value.replace(",", " "), 4)
    recording = read(rows)
    assert recording.log.stamps_ns.tolist() == [message.ns for message in drive()[4:]]
    skipped = next(note for note in recording.notes if "skipped" in note)
    assert skipped.startswith(f"4 bad rows skipped, the first of them row 2: {column} is ")
    with pytest.raises(CamError, match=rf"cam\.csv, row 2: {column} is .*; needed is .* \(5 of 20 rows are bad"):
        read(put(rows, column, value.replace(",", " "), 5))


def test_a_row_with_too_many_fields_is_bad(read: Read) -> None:
    rows = table(drive())
    rows[3] = ["", *rows[3], "x"]
    notes = read(rows).notes
    assert notes == ("1 bad rows skipped, the first of them row 4: it has 11 fields; needed are 9",)


@pytest.mark.parametrize(("column", "value"), [("heading", "999"), ("speed", "200"), ("vehicle_length", "250.5")])
def test_an_impossible_value_is_missing_and_many_are_refused(read: Read, column: str, value: str) -> None:
    recording = read(put(table(drive()), column, value, 4))
    assert len(recording.log) == 20
    assert any(note.startswith(f"4 values taken as missing: {column} is {value}") for note in recording.notes)
    with pytest.raises(CamError, match=rf"{column} is {value} .* in row 2 and the like in 5 of 20 rows; needed is"):
        read(put(table(drive()), column, value, 5))


def test_speeds_of_a_vehicle_that_reverses_are_magnitudes(read: Read) -> None:
    """A CAM has the direction apart; loggers write it as a sign, and noise about 0 where a vehicle waits."""
    rows = table(drive())
    plain = read(rows).log.speed_mps
    column = rows[0].index("speed")
    signed = [rows[0], *([*row[:column], f"-{row[column]}", *row[column + 1 :]] for row in rows[1:])]
    recording = read(signed)
    np.testing.assert_array_equal(recording.log.speed_mps, plain)
    assert f"{len(plain)} speeds are negative; taken as magnitudes" in recording.notes


@pytest.mark.parametrize("title", ["driveDirection", "drive_direction", "Drive Direction"])
@pytest.mark.parametrize(
    ("text", "back"),
    [
        *((text, True) for text in ("backward", "Backward", "1", "1.0")),
        *((text, False) for text in ("forward", "0", "unavailable", "2", "")),
    ],
)
def test_a_column_tells_who_drives_backwards(read: Read, title: str, text: str, back: bool) -> None:
    rows = table(drive(speed=2.0))
    recording = read([[*row, text if i else title] for i, row in enumerate(rows)])
    assert recording.log.heading_deg == pytest.approx(np.full(20, 255.3 if back else 75.3))
    assert any("20 messages with driveDirection backward" in note for note in recording.notes) == back


def test_a_drive_direction_that_is_none_is_noted(read: Read) -> None:
    rows = [[*row, "left" if i else "driveDirection"] for i, row in enumerate(table(drive(speed=2.0)))]
    recording = read(rows)
    assert (recording.log.heading_deg == 75.3).all()
    assert any(note.startswith("driveDirection is 'left' and the like in 20 rows") for note in recording.notes)


def test_positions_at_zero_and_missing_ones_are_no_positions(read: Read) -> None:
    rows = put(put(table(drive()), "latitude", "0.0", 3), "longitude", "0", 3)
    rows = [*rows[:1], *put([rows[0], *rows[1:][::-1]], "latitude", "", 2)[1:]]
    recording = read(rows)
    assert np.isnan(recording.log.latitude_deg).sum() == 5
    assert "3 positions are 0, 0; taken as missing" in recording.notes
    assert "5 rows without position" in recording.notes
    for value in ("0", "", "900000001"):
        none = put(put(table(drive()), "latitude", value, 20), "longitude", value or "9.9", 20)
        with pytest.raises(CamError, match=r"cam\.csv holds no position"):
            read(none)


def exchanged(rows: list[list[str]]) -> list[list[str]]:
    a, b = rows[0].index("latitude"), rows[0].index("longitude")
    return [rows[0], *([*row[:a], row[b], *row[a + 1 : b], row[a], *row[b + 1 :]] for row in rows[1:])]


@pytest.mark.parametrize("columns", [CANONICAL, RAW], ids=["degrees", "raw"])
@pytest.mark.parametrize("heading", [0.0, 45.0, 75.0, 120.0, 200.0, 315.0])
def test_exchanged_positions_do_not_move_as_they_should(read: Read, columns: Columns, heading: float) -> None:
    rows = table(drive(heading=heading), columns)
    assert len(read(rows).log) == 20
    with pytest.raises(CamError, match=r"cam\.csv: latitude and longitude look exchanged"):
        read(exchanged(rows))


@given(st.floats(0, 359.9), st.floats(-70, 70))
@fuzz
def test_a_reversing_vehicle_is_not_taken_for_exchanged_positions(
    tmp_path: Path, heading: float, latitude: float
) -> None:
    reversing = [
        replace(message, heading=(heading + 180) % 360) for message in drive(heading=heading, latitude=latitude)
    ]
    path = write(tmp_path / "cam.csv", table(reversing))
    if abs(np.cos(np.radians(latitude)) - np.cos(np.radians(9.9434))) > 0.15:
        assert len(read_cam_csv(path).log) == 20


def test_a_latitude_beyond_the_pole_is_a_longitude(read: Read) -> None:
    rows = table([replace(message, longitude=message.longitude + 100) for message in drive()])
    assert len(read(rows).log) == 20
    with pytest.raises(
        CamError, match=r"latitude and longitude look exchanged: they are 109\.94\d\d and 48\.42\d\d deg"
    ):
        read(exchanged(rows))


def test_what_is_no_log(tmp_path: Path) -> None:
    path = tmp_path / "cam.csv"
    header = ",".join(CANONICAL)
    for content, message in (
        (None, "does not exist"),
        (b"", "is empty"),
        (b"\n\n", "is empty"),
        (header.encode(), "holds a header but no rows"),
        (bytes(range(256)) * 4, "is not a text file"),
        (b"\x7fELF\0\0\0\0", "is not a text file: character 4 is NUL"),
        ("\n".join(",".join(row) for row in table(drive())[1:]).encode(), "begins with 1760000002.237000000, 4711"),
        (b"hello\nworld\n", "lacks the column timestamp, latitude, longitude"),
    ):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(CamError, match=rf"cam\.csv {message}"):
            read_cam_csv(path)
    with pytest.raises(CamError, match="is a folder; needed is a file"):
        read_cam_csv(tmp_path)


def test_any_file_is_read_or_refused(tmp_path: Path) -> None:
    whole = write(tmp_path / "cam.csv", table(drive(n=4))).read_bytes()
    words = (",".join(CANONICAL) + "\n", ",", "\n", ";", '"', "1760000000.5", "48.4", "9e9", "-1", "0", "1e999", "\r")

    @fuzz
    @given(st.one_of(mutations(whole), noise(*words)))
    def check(content: bytes) -> None:
        path = tmp_path / "x.csv"
        path.write_bytes(content)
        recording = read_or_refused(lambda: read_cam_csv(path), CamError)
        if recording is not None:
            assert (np.diff(recording.log.stamps_ns) >= 0).all()
            assert np.nanmax(np.abs(recording.log.latitude_deg)) <= 90

    check()


@needs_shared
@pytest.mark.parametrize(("name", "count"), [("crossing", 99), ("crossing_b", 95)])
def test_the_shared_logs(name: str, count: int) -> None:
    recording = read_cam_csv(SHARED / "data" / name / "cam.csv")
    assert (len(recording.log), recording.notes, recording.log.stations()) == (count, (), [4711])
    assert recording.log.stamps_ns[0] == 1760000002_237000000
