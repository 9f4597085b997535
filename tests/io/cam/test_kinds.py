from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from laci_stereo.core.errors import CamError
from laci_stereo.io.cam.log import read_cam_log
from laci_stereo.io.cam.recording import CamRecording
from tests.io import cam_writers as writers
from tests.io.cam.test_cam_log import assert_same_track
from tests.io.cam_writers import drive

LOG = drive(20)
PLACE = {"latitude": 484226000, "longitude": 99434000}
BODIES: dict[str, tuple[int, str, dict[str, Any]]] = {
    "DENM": (1, "denm", {"management": {"eventPosition": PLACE}}),
    "SPATEM": (4, "spat", {"intersections": [{"id": {"id": 3}}]}),
    "MAPEM": (5, "map", {"intersections": [{"refPoint": PLACE}]}),
    "VAM": (16, "vam", {"vamParameters": {"basicContainer": {"referencePosition": PLACE}}}),
}


def cams(written: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in writers.write_json_lines(written, LOG).read_text().splitlines()]


def others(kind: str, at: float = 1_760_000_002.3) -> dict[str, Any]:
    message_id, name, body = BODIES[kind]
    return {"timestamp": at, "fields": {"header": {"messageID": message_id, "stationID": 9}, name: body}}


def read(folder: Path, text: str) -> CamRecording:
    (folder / "log").write_text(text)
    return read_cam_log(folder / "log")


def refusal(folder: Path, text: str) -> str:
    with pytest.raises(CamError) as refused:
        read(folder, text)
    assert len(str(refused.value).splitlines()) == 1
    return str(refused.value)


def assert_only_cams(recording: CamRecording, *notes: str) -> None:
    assert set(recording.log.station_id.tolist()) == set(LOG.station_id.tolist())
    assert_same_track(recording.log, LOG)
    assert all(any(wanted in note for note in recording.notes) for wanted in notes)


@pytest.mark.parametrize("as_lines", [True, False])
@pytest.mark.parametrize("with_header", [True, False])
def test_json_of_other_messages_is_left_out_and_counted(as_lines: bool, with_header: bool, tmp_path: Path):
    sent = cams(tmp_path)
    records = [other for kind in BODIES for other in [others(kind)] * (1 + len(kind))] + sent
    if not with_header:
        for record in records:
            record["fields"].pop("header", None)
        for record in sent:
            record["stationID"] = int(LOG.station_id[0])
    text = "\n".join(map(json.dumps, records)) if as_lines else json.dumps(records)
    assert_only_cams(read(tmp_path, text), "records that are no CAM of a vehicle left out: 7 x SPATEM, 6 x MAPEM, 5 x")


def test_the_type_tells_flat_records(tmp_path: Path):
    flat = [dict(writers.leaves(record)) for record in cams(tmp_path)]
    wrong = [{**record, "stationID": 9} for record in flat]
    for name in ("type", "messageType", "msg_type"):
        records = [{**record, name: "CAM"} for record in flat] + [{**record, name: "denm"} for record in wrong]
        assert_only_cams(read(tmp_path, json.dumps(records)), "left out: 20 x DENM")


def test_lists_of_their_own(tmp_path: Path):
    text = json.dumps({"cams": cams(tmp_path), "denms": [others("DENM")] * 3, "notes": []})
    assert_only_cams(read(tmp_path, text), "left out: 3 x DENM")


def test_no_cam_at_all(tmp_path: Path):
    said = refusal(tmp_path, json.dumps([others("VAM"), others("VAM"), others("DENM")]))
    assert "holds no CAM of a vehicle, but 2 x VAM, 1 x DENM; needed are CAMs" in said


def test_a_roadside_unit_sends_cams_too(tmp_path: Path):
    sent = cams(tmp_path)
    high = {"rsuContainerHighFrequency": {}}
    unit = {"basicContainer": {"referencePosition": PLACE}, "highFrequencyContainer": high}
    mine = {"timestamp": 1_760_000_002.3, "header": {"stationID": 9}, "cam": {"camParameters": unit}}
    assert_only_cams(read(tmp_path, json.dumps([mine, *sent])), "1 x CAM of a roadside unit")


def test_rows_of_other_messages(tmp_path: Path):
    log = LOG
    head = "timestamp,its.messageID,station_id,latitude,longitude"
    rows = [
        f"{ns / 1e9:.3f},{message_id},{station},{latitude:.7f},{longitude:.7f}"
        for message_id, station in ((2, log.station_id[0]), (16, 9))
        for ns, latitude, longitude in zip(log.stamps_ns, log.latitude_deg, log.longitude_deg, strict=True)
    ]
    assert_only_cams(read(tmp_path, "\n".join([head, *rows])), "rows that are no CAM of a vehicle left out: 20 x VAM")
    assert "but 20 x VAM" in refusal(tmp_path, "\n".join([head, *rows[20:]]))


def test_a_running_number_is_no_kind(tmp_path: Path):
    log = LOG
    rows = [
        f"{ns / 1e9:.3f},{i},{latitude:.7f},{longitude:.7f}"
        for i, (ns, latitude, longitude) in enumerate(
            zip(log.stamps_ns, log.latitude_deg, log.longitude_deg, strict=True), 1
        )
    ]
    assert_same_track(read(tmp_path, "\n".join(["timestamp,message_id,latitude,longitude", *rows])).log, log)


def test_a_line_that_is_cut_off_is_left_out(tmp_path: Path):
    lines = writers.write_json_lines(tmp_path, LOG).read_text().splitlines()
    recording = read(tmp_path, "\n".join([*lines, lines[-1][:80]]))
    assert_only_cams(recording, "1 bad lines skipped, the first of them line 21")
    assert "needed is JSON (6 of 26 lines are bad" in refusal(tmp_path, "\n".join([*lines, *["{"] * 6]))


def test_points_of_geojson_and_other_features(tmp_path: Path):
    text = writers.write_geojson(tmp_path, LOG).read_text()
    assert_only_cams(read(tmp_path, text), "1 x 'LineString'")
    lines = json.loads(text)["features"][:1]
    assert "but 1 x 'LineString'; needed are CAMs" in refusal(
        tmp_path, json.dumps({"type": "FeatureCollection", "features": lines})
    )
