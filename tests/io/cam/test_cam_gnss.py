from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from laci_stereo.core.errors import CamError
from laci_stereo.core.messages.cam import ELLIPSE_SIGMAS, CamLog
from laci_stereo.io.cam.columns import ELLIPSE_ORIENTATION, LATITUDE, LONGITUDE, SEMI_MAJOR, SEMI_MINOR
from laci_stereo.io.cam.gnss import ellipse_95, gnss_messages, recorded_drive
from laci_stereo.io.cam.log import read_cam_log
from tests.io import cam_writers as writers
from tests.io.cam.test_cam_log import assert_same_track
from tests.io.cam_asn1 import compiled, vehicle_cam
from tests.io.cam_writers import START_NS, WGS84, drive
from tests.io.support import fuzz, noise, read_or_refused


def read(folder: Path, text: str) -> tuple[CamLog, tuple[str, ...]]:
    (folder / "log").write_text(text)
    recording = read_cam_log(folder / "log")
    return recording.log, recording.notes


def refusal(folder: Path, text: str) -> str:
    (folder / "log").write_text(text)
    with pytest.raises(CamError) as refused:
        read_cam_log(folder / "log")
    assert len(str(refused.value).splitlines()) == 1
    return str(refused.value)


@settings(deadline=None)
@given(
    st.floats(-80, 80).filter(lambda latitude: abs(latitude) > 1),
    st.floats(-180, 180),
    st.floats(0, 359.9),
    st.floats(2, 50),
)
def test_the_motion_tells_heading_and_speed(latitude: float, longitude: float, heading: float, speed: float):
    fixes = {}
    for i in range(10):
        east, north, _ = WGS84.fwd(longitude, latitude, heading, speed * (i / 10))
        fixes[i] = (START_NS + i * 10**8, {LATITUDE: north, LONGITUDE: east})
    log = recorded_drive(gnss_messages(Path("a"), "point", fixes, {}), [], "a test").log
    # A geodesic turns by up to 5.7 arc seconds in 45 m at 80 deg, and double precision keeps degrees to 3 nm there.
    turned = (log.heading_deg - heading + 180.0) % 360.0 - 180.0
    assert np.abs(turned).max() < 0.01
    np.testing.assert_allclose(log.speed_mps, speed, rtol=1e-5)


def test_motion_follows_the_time_and_not_the_order_of_the_file():
    """Fixes along a quarter of a circle, some of them late, and one twice."""
    at = np.array([0, 3, 1, 2, 2, 4, 6, 5, 7, 8])
    degrees = 10.0 * at
    east, north, _ = WGS84.fwd(np.full(10, 9.0), np.full(10, 48.0), degrees, np.full(10, 30.0))
    fixes = {
        i: (START_NS + int(at[i]) * 10**9, {LATITUDE: float(north[i]), LONGITUDE: float(east[i])}) for i in range(10)
    }
    log = recorded_drive(gnss_messages(Path("a"), "point", fixes, {}), [], "a test").log
    second = (log.stamps_ns - START_NS) // 10**9
    inside = (second > 0) & (second < 8)
    turned = (log.heading_deg - (10.0 * second + 90.0) + 180.0) % 360.0 - 180.0
    assert inside.sum() >= 7
    assert np.abs(turned[inside]).max() < 1.0


def test_across_a_gap_there_is_no_motion():
    places = {0: 0.0, 1: 0.1, 2: 0.2, 3: 10.0, 4: 20.0, 5: 20.1}
    fixes = {i: (START_NS + round(at * 1e9), {LATITUDE: 48.0 + at * 1e-4, LONGITUDE: 9.0}) for i, at in places.items()}
    log = recorded_drive(gnss_messages(Path("a"), "point", fixes, {}), [], "a test").log
    assert np.isfinite(log.heading_deg).tolist() == [True, True, True, False, True, True]


@given(st.floats(0.01, 10), st.floats(0.01, 1), st.floats(0, 179.9))
def test_the_ellipse_of_a_covariance(major_m: float, share: float, orientation_deg: float):
    angle = np.radians(orientation_deg)
    axes = np.array([[np.sin(angle), np.cos(angle)], [np.cos(angle), -np.sin(angle)]])
    covariance = axes @ np.diag([major_m**2, (share * major_m) ** 2]) @ axes.T
    found = ellipse_95(covariance)
    assert found[SEMI_MAJOR] == pytest.approx(ELLIPSE_SIGMAS * major_m)
    assert found[SEMI_MINOR] == pytest.approx(ELLIPSE_SIGMAS * share * major_m, abs=1e-6)
    if share < 0.9:
        assert (found[ELLIPSE_ORIENTATION] - orientation_deg + 90) % 180 == pytest.approx(90, abs=1e-6)


@pytest.mark.parametrize("covariance", [[[np.nan, 0], [0, 1]], [[-1.0, 0], [0, 1]], [[0.0, 0], [0, 0]]])
def test_what_is_no_covariance_tells_nothing(covariance: list[list[float]]):
    assert ellipse_95(np.array(covariance)) == {}


# NMEA


@pytest.mark.parametrize("kinds", ["RMC", "GGA RMC", "RMC GGA", "GGA GST VTG RMC", "RMC VTG GGA GST"])
def test_sentences_in_any_order(kinds: str, tmp_path: Path):
    log = drive(20)
    lines = writers.nmea_lines(log)
    named = [{line[3:6]: line for line in lines[i : i + 4]} for i in range(0, len(lines), 4)]
    found, _ = read(tmp_path, "\n".join(moment[kind] for moment in named for kind in kinds.split()))
    assert_same_track(found, log)
    np.testing.assert_allclose(found.heading_deg, log.heading_deg, rtol=0, atol=0.006)
    np.testing.assert_allclose(found.speed_mps, log.speed_mps, rtol=0, atol=0.001)
    if "GST" in kinds:
        np.testing.assert_allclose(found.semi_major_95_m, 0.02 * ELLIPSE_SIGMAS)
        np.testing.assert_allclose(found.ellipse_orientation_deg, 30.0)


def test_what_loggers_put_around_sentences(tmp_path: Path):
    log = drive(20)
    found, notes = read(tmp_path, "\n".join(f"2025-10-09 08:53:22.25 rx: {line}" for line in writers.nmea_lines(log)))
    assert_same_track(found, log)
    assert not any("bad" in note for note in notes)


def test_a_date_that_only_some_sentences_tell_is_that_of_all(tmp_path: Path):
    log = drive(20)
    midnight = START_NS // (86400 * 10**9) * 86400 * 10**9 + 86400 * 10**9
    late = CamLog(midnight - 10**9 + np.arange(20) * 100_000_000, *list(vars(log).values())[1:])
    lines = writers.nmea_lines(late)
    gga, rmc = lines[0::4], lines[2::4]
    for at in (0, 5, 15):
        found, _ = read(tmp_path, "\n".join([*gga[:at], rmc[at], *gga[at:]]))
        assert_same_track(found, late)


def test_bad_sentences_are_counted_and_those_without_a_fix_left_out(tmp_path: Path):
    log = drive(20)
    lines = writers.nmea_lines(log)
    lines[4] = lines[4].replace("N,", "S,", 1)
    lines[9] = "$GNGGA,085322.00,xx,N,9,E,4"
    lines.insert(0, writers.sentence("GNRMC,000000.00,V,,,,,,,091025,,,N"))
    found, notes = read(tmp_path, "\n".join(lines))
    assert any("2 bad lines skipped, the first of them line 6: the checksum of" in note for note in notes)
    assert any("1 moments without a position" in note for note in notes)
    assert len(found) == 20


def test_sentences_that_do_not_suffice(tmp_path: Path):
    lines = writers.nmea_lines(drive(5))
    assert "without a date; needed are RMC or ZDA sentences" in refusal(tmp_path, "\n".join(lines[0::4]))
    assert "holds no position" in refusal(tmp_path, writers.sentence("GNRMC,000000.00,V,,,,,,,091025,,,N"))
    zda = writers.sentence("GPZDA,085322.237,09,10,2025,00,00")
    assert len(read(tmp_path, "\n".join([zda, *lines[0::4]]))[0]) == 5
    late = writers.sentence("GPZDA,085322.237,09,10,9999,00,00")
    assert "without a date" in refusal(tmp_path, "\n".join([late, *lines[0::4]]))


@fuzz
@given(
    noise("$GPGGA,", "$GNRMC,", "085322.24", ",A,", "4825.2,N,", "00956.6,E,", "091025", "*", "\n", "$GPVTG,", "9" * 30)
)
def test_noise_of_sentences(tmp_path: Path, content: bytes):
    (tmp_path / "log").write_bytes(b"$GPRMC,085322.24,A,4825.2,N,00956.6,E,1,2,091025\n" + content)
    read_or_refused(lambda: read_cam_log(tmp_path / "log"), CamError)


# GPX


def gpx(points: str, head: str = "") -> str:
    return f'<?xml version="1.0"?>{head}<gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{points}</trkseg></trk></gpx>'


def point(second: int, latitude: str = "48.4", extra: str = "") -> str:
    return f'<trkpt lat="{latitude}{second}" lon="9.9"><time>2025-10-09T08:53:{second:02d}Z</time>{extra}</trkpt>'


def test_speed_and_course_of_extensions_are_used(tmp_path: Path):
    extra = "<extensions><g:T xmlns:g='x'><g:speed>7.5</g:speed><g:course>123.4</g:course></g:T></extensions>"
    found, notes = read(tmp_path, gpx("".join(point(i, extra=extra) for i in range(10, 15))))
    assert set(found.speed_mps) == {7.5}
    assert set(found.heading_deg) == {123.4}
    assert not any("motion" in note for note in notes)


def test_xml_that_grows_or_is_no_track_is_refused(tmp_path: Path):
    bomb = '<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;">]>'
    assert "a document type" in refusal(tmp_path, gpx("&b;", bomb))
    assert "root element 'kml', no log; needed is gpx" in refusal(tmp_path, "<kml></kml>")
    assert "a lane map is given with --map" in refusal(tmp_path, "<osm></osm>")
    assert "(tshark's JSON is read: -T json)" in refusal(tmp_path, "<pdml></pdml>")


@pytest.mark.parametrize("count", [1, 2])
def test_messages_in_xer_are_named_and_the_remedy(count: int, tmp_path: Path):
    data = compiled(rules="xer").encode("CAM", vehicle_cam()).decode()
    said = refusal(tmp_path, '<?xml version="1.0"?>\n' + data * count)
    assert "ASN.1's XML (XER), which tell no time of reception" in said
    assert "needed are lines of JSON with a timestamp and the decoded message in each" in said
    assert "needed is well-formed XML" in refusal(tmp_path, "<gpx><trk>")
    assert "holds no position" in refusal(tmp_path, gpx(""))
    assert "point 1: it has no time" in refusal(tmp_path, gpx('<trkpt lat="1" lon="2"/>'))
    assert "lat is 'x10'; needed is a number" in refusal(tmp_path, gpx(point(10, "x")))
    assert "latitude is 480" in refusal(tmp_path, gpx(point(10, "480")))
    refusal(tmp_path, "<a>" * 100_000)
    nested = "<trkpt lat='1' lon='2'>" * 20_000 + "</trkpt>" * 20_000
    assert "20000 of 20000 points are bad" in refusal(tmp_path, gpx(nested))


@fuzz
@given(
    noise(
        "<trkpt lat='48.4' lon='9.9'>",
        "<time>2025-10-09T08:53:22Z</time>",
        "</trkpt>",
        "<ele>",
        "</ele>",
        "NaN",
        "1e999",
    )
)
def test_noise_of_gpx(tmp_path: Path, content: bytes):
    (tmp_path / "log").write_bytes(b"<gpx>" + content + b"</gpx>")
    read_or_refused(lambda: read_cam_log(tmp_path / "log"), CamError)


# RTKLIB


@pytest.mark.parametrize("scale", ["GPST", "UTC"])
@pytest.mark.parametrize("weeks", [True, False])
def test_solutions_of_rtklib(scale: str, weeks: bool, tmp_path: Path):
    log = drive(20)
    recording = read_cam_log(writers.write_rtklib(tmp_path, log, scale, weeks))
    assert_same_track(recording.log, log)
    assert recording.is_receiver
    assert ("times: GPS time, less the 18 leap seconds of UTC" in recording.notes) == (scale == "GPST")
    expected = ellipse_95(np.array([[0.01**2, -(0.005**2)], [-(0.005**2), 0.02**2]]))
    np.testing.assert_allclose(recording.log.semi_major_95_m, expected[SEMI_MAJOR])
    np.testing.assert_allclose(recording.log.ellipse_orientation_deg, expected[ELLIPSE_ORIENTATION])


def test_other_solutions_of_rtklib_are_refused(tmp_path: Path):
    text = writers.write_rtklib(tmp_path, drive(20)).read_text()
    for old, new in (("GPST", "JST"), ("latitude(deg)", "x-ecef(m)"), ("latitude(deg)", "latitude(d'\")")):
        said = refusal(tmp_path, text.replace(old, new))
        assert "needed are GPST or UTC, and latitude and longitude in degrees (out-solformat llh" in said
    lines = text.splitlines()
    assert "holds no position" in refusal(tmp_path, "\n".join(lines[:4]))
    for bad, said in (("2025/10/09 08:53:22.2 48.4", "lacks numbers"), ("a b 48.4 9.9 1", "time is 'a b'")):
        found, notes = read(tmp_path, "\n".join([*lines, bad]))
        assert len(found) == 20
        assert any("1 bad lines skipped" in note and said in note for note in notes)


@fuzz
@given(noise("2025/10/09 ", "08:53:22.2 ", "2387 ", "48.4 9.9 560 1 9 ", "-0.1 ", "nan ", "\n", "%", "9" * 30))
def test_noise_of_rtklib(tmp_path: Path, content: bytes):
    head = b"% GPST latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) sdne(m)\n"
    (tmp_path / "log").write_bytes(head + b"2025/10/09 08:53:22.2 48.4 9.9 560 1 9 1 1 1 1\n" + content)
    read_or_refused(lambda: read_cam_log(tmp_path / "log"), CamError)


# JSON


def v2aix(log: CamLog, change: Any = None) -> str:
    path = {
        "/v2x/cam": [
            {"recording_timestamp_nsec": ns, "message": writers.ros_values(log, i)}
            for i, ns in enumerate(writers.received(log))
        ]
    }
    if change is not None:
        change(path["/v2x/cam"])
    return json.dumps(path)


def test_json_of_a_later_release(tmp_path: Path):
    log = drive(10)
    text = v2aix(log)
    for old, new in (
        ("semi_major_confidence", "semi_major_axis_length"),
        ("semi_minor_confidence", "semi_minor_axis_length"),
        ("semi_major_orientation", "semi_major_axis_orientation"),
    ):
        text = text.replace(old, new)
    found, _ = read(tmp_path, text)
    assert_same_track(found, log)
    np.testing.assert_array_equal(found.semi_major_95_m, log.semi_major_95_m)


def test_bad_messages_and_other_kinds_in_json(tmp_path: Path):
    def change(records: list[dict[str, Any]]) -> None:
        position = records[1]["message"]["cam"]["cam_parameters"]["basic_container"]["reference_position"]
        position["latitude"]["value"] = "north"
        records[2]["recording_timestamp_nsec"] = -5
        records[3]["message"]["cam"]["cam_parameters"]["high_frequency_container"]["choice"] = 1
        records.append({"message": {"denm": {}}})

    found, notes = read(tmp_path, v2aix(drive(20), change))
    assert len(found) == 17
    assert any(
        "2 bad messages skipped, the first of them message 2: cam.cam_parameters.basic" in note for note in notes
    )
    assert any("1 x CAM of a roadside unit" in note and "1 x message of '/v2x/cam'" in note for note in notes)


def test_other_json_is_refused(tmp_path: Path):
    assert "needed is JSON" in refusal(tmp_path, "{")
    assert "needed is JSON" in refusal(tmp_path, "[" * 100_000)
    assert "needed is JSON" in refusal(tmp_path, '{"a": ' + "9" * 10_000 + "}")
    assert "no object of topics" in refusal(tmp_path, "[1, 2]")
    assert "no object of topics" in refusal(tmp_path, '{"type": "FeatureCollection"}')
    assert (
        "records lack timestamp; needed are timestamp, latitude and longitude in each, and they hold cam.latitude, "
        in (refusal(tmp_path, '{"cam": {"latitude": 1, "longitude": 2}}'))
    )
    assert "needed is JSON" in refusal(tmp_path, '{"timestamp": 1760000000}\n{"timestamp": 17')
    assert "no object of topics" in refusal(tmp_path, '{"a": ' * 900 + "[1]" + "}" * 900)
    assert "holds no CAM of a vehicle, but 2 x message of '/x'" in refusal(tmp_path, '{"/x": [1, {"message": null}]}')


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["value", "choice", "a"]), inner, max_size=2)
    ),
    max_leaves=5,
)
NAMES = [
    "latitude",
    "reference_position",
    "header",
    "station_id",
    "cam",
    "message",
    "recording_timestamp_nsec",
    "speed_value",
]


@fuzz
@given(JSON, st.sampled_from(NAMES))
def test_any_value_in_place_of_any_element(tmp_path: Path, value: Any, name: str):
    def put(found: Any) -> None:
        if isinstance(found, dict):
            if name in found:
                found[name] = value
            else:
                for inner in found.values():
                    put(inner)

    text = v2aix(drive(8), lambda records: put(records[3]))
    (tmp_path / "log").write_text(text)
    found = read_or_refused(lambda: read_cam_log(tmp_path / "log"), CamError)
    assert found is None or len(found.log) >= 7
    fix = {"recording_timestamp_nsec": START_NS, "message": {"latitude": 1.0, "longitude": 2.0, "altitude": value}}
    fix["message"]["position_covariance"] = [value] * 9
    (tmp_path / "log").write_text(json.dumps({"/fix": [fix]}))
    read_or_refused(lambda: read_cam_log(tmp_path / "log"), CamError)
