"""A valid, small input of every format of every reader: what is damaged to try the readers."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import ezdxf
import numpy as np

from laci_stereo.core.messages.cam import CamLog
from laci_stereo.io.result.calibration_file import to_text
from laci_stereo.io.result.exports import FORMATS as EXPORTS
from laci_stereo.io.result.exports import export_as
from laci_stereo.io.result.imported import ImportOptions, import_pose, imported_document
from tests.io import cam_writers, map_writers, rig_writers
from tests.io.cam.test_cam_log import COMPLETE, POSITIONS
from tests.io.maps.test_map_formats import LINES
from tests.io.result.test_evidence_file import content
from tests.io.result.test_imported import WRITTEN
from tests.io.rig.test_rig_formats import MIDDLEBURY, RIGS
from tests.io.sitings import siting
from tests.io.support import write_images
from tests.io.test_detections import rows
from tests.lidar.support import FILE_FORMATS, scene, write_bag1, write_bag2, write_folder
from tests.mask import graphs

FIRST_NS = 1_760_000_000_100_000_000


def write_seeds(folder: Path) -> None:
    """Write the files of each format into a folder ``reader/form``."""
    for reader, write in _WRITERS.items():
        write(folder / reader)


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder


def _cams(folder: Path) -> None:
    log = cam_writers.drive(8)
    forms: dict[str, Callable[[Path, CamLog], object]] = {
        **COMPLETE,
        **POSITIONS,
        "CSV": lambda inside, log: (inside / "cam.csv").write_text(cam_writers.csv_text(log)),
        "CSV of ETSI": lambda inside, log: (inside / "cam.csv").write_text(_etsi_csv(log)),
        "UPER": lambda inside, log: (inside / "cam.bin").write_bytes(b"".join(cam_writers.cams(log))),
    }
    for form, write in forms.items():
        write(_made(folder / form), log)


def _etsi_csv(log: CamLog) -> str:
    """Write times as people read them, and the numbers as they go over the air."""
    rows = ["timestamp;station_id;latitude;longitude;heading;speed;vehicle_length;vehicle_width"]
    for i, ns in enumerate(log.stamps_ns):
        numbers = (
            *(round(log.latitude_deg[i] * 1e7), round(log.longitude_deg[i] * 1e7), round(log.heading_deg[i] * 10)),
            *(round(log.speed_mps[i] * 100), round(log.length_m[i] * 10), round(log.width_m[i] * 10)),
        )
        rows.append(f"{np.datetime64(int(ns), 'ns')}Z;{log.station_id[i]};{';'.join(map(str, numbers))}")
    return "\n".join(rows)


def _rigs(folder: Path) -> None:
    for form, known in rig_writers.FORMATS.items():
        known.write(_made(folder / form), RIGS[known.rigs[0]])
    fisheye = rig_writers.FORMATS["kalibr"]
    fisheye.write(_made(folder / "kalibr fisheye"), RIGS["fisheye"])
    sized = MIDDLEBURY.replace("2964", "400").replace("2000", "300")
    sized = sized.replace("1244.772", "200.5").replace("1369.115", "324.843").replace("1019.507", "150.5")
    (_made(folder / "middlebury") / "calib.txt").write_text(sized)
    left = np.pad(RIGS["ideal"].left.K, ((0, 0), (0, 1)))
    right = left - np.pad(left[:, :1] * 0.54, ((0, 0), (3, 0)))
    lines = [f"P{i}: {rig_writers.numbers(P)}" for i, P in enumerate((left, right, left, right))]
    (_made(folder / "kitti rectified") / "calib.txt").write_text("\n".join(lines))


LANES = """<laneOffset s='0' a='0.5' b='0' c='0' d='0'/><laneSection s='0'>
  <left><lane id='1'><width sOffset='0' a='3' b='0.01' c='0' d='0'/><roadMark sOffset='0' type='broken'/>
    <roadMark sOffset='40' type='solid solid' weight='bold'/></lane></left>
  <center><lane id='0'><roadMark sOffset='0' type='none'/></lane></center>
  <right><lane id='-1'><width sOffset='0' a='3' b='0' c='0' d='0'/><roadMark sOffset='0' type='curb'/></lane>
    <lane id='-2'><border sOffset='0' a='-9' b='0' c='0' d='0'/></lane></right></laneSection>"""

PLAN = """<geometry s='0' x='0' y='0' hdg='0.1' length='20'><line/></geometry>
  <geometry s='20' x='20' y='2' hdg='0.1' length='30'><arc curvature='0.05'/></geometry>
  <geometry s='50' x='40' y='20' hdg='1.6' length='30'><spiral curvStart='0.05' curvEnd='-0.02'/></geometry>
  <geometry s='80' x='40' y='50' hdg='1.6' length='10'><poly3 a='0' b='0.1' c='0' d='0'/></geometry>
  <geometry s='90' x='40' y='60' hdg='1.6' length='10'><paramPoly3 pRange='normalized'
    aU='0' bU='10' cU='0' dU='0' aV='0' bV='0' cV='0.4' dV='0'/></geometry>"""


def _maps(folder: Path) -> None:
    east, north = map_writers.WORLD.origin_utm
    plan = f"<road id='1' length='100'><planView>{PLAN}</planView><lanes>{LANES}</lanes></road>"
    utm = "+proj=utm +zone=32 +datum=WGS84"
    texts = {
        "lanelet2": map_writers.lanelet2(LINES[:3]),
        "lanelet2 local": map_writers.lanelet2(LINES[:3], local_from=(0.0, 0.0)),
        "geojson": map_writers.geojson(LINES[:3]),
        "geojson utm": map_writers.geojson(LINES[:3], "EPSG:32632"),
        "csv": map_writers.csv(LINES[:3]),
        "csv degrees": map_writers.csv(LINES[:3], "id,lat,lon,type,subtype"),
        "opendrive": map_writers.opendrive(plan, utm, (east, north, 0.0)),
        "opendrive straight": map_writers.straight_roads(LINES[1:2]),
    }
    for form, text in texts.items():
        (_made(folder / form) / "map").write_text(text)
    map_writers.dxf(LINES[:2], _made(folder / "dxf") / "map.dxf")
    drawing = ezdxf.new(units=6)
    space, (e, n) = drawing.modelspace(), map_writers.WORLD.origin_utm
    space.add_line((e, n), (e + 3, n + 4), dxfattribs={"layer": "line_thin-dashed"})
    space.add_polyline2d([(e, n), (e + 5, n + 5)], dxfattribs={"layer": "curbstone"})
    space.add_polyline3d([(e, n, 400), (e + 5, n + 6, 401)])
    space.add_arc((e + 10, n + 20), 50.0, 0.0, 90.0)
    space.add_spline([(e, n), (e + 10, n + 5), (e + 20, n), (e + 30, n + 5)])
    space.add_lwpolyline([(e, n, 1.0), (e + 40, n, 0.0), (e + 60, n, 0.0)], format="xyb")
    drawing.saveas(_made(folder / "dxf shapes") / "map.dxf")
    drawing.saveas(_made(folder / "dxf binary") / "map.dxf", fmt="bin")


def _poses(folder: Path) -> None:
    for form in EXPORTS:
        inside = _made(folder / form.name)
        for file in export_as(siting("stereo"), form.name):
            (inside / file.name).write_text(file.text)


def _local_poses(folder: Path) -> None:
    for form, text in WRITTEN.items():
        (_made(folder / form) / "mast.txt").write_text(text)


def _calibrations(folder: Path) -> None:
    for form, covariance in (("imported", None), ("joint", (np.eye(6) * 1e-4).tolist())):
        (_made(folder) if not folder.exists() else folder).joinpath(form).mkdir()
        pose = folder / form / "pose.yaml"
        pose.write_text(export_as(siting("stereo"), "opencv")[0].text)
        document = imported_document(import_pose(pose, ImportOptions()), {"x": "y"}, {})
        pose.unlink()
        document["covariance"] = covariance
        (folder / form / "calibration.json").write_text(to_text(document))


CONTRACT = {
    "kind": "yolov8_raw",
    "vehicle_ids": [2, 5, 7],
    "input": {"layout": "NCHW", "mean": [0.5, 0.5, 0.5], "std": [1.0], "size": [640, 480], "crops": [2, 1]},
    "output": {"score": 0.3, "names": ["a", "b"], "strides": [8, 16]},
}


def _masks(folder: Path) -> None:
    graphs.save(graphs.semantic(), _made(folder / "onnx"))


def _scans(folder: Path) -> None:
    for form, (suffix, write) in FILE_FORMATS.items():
        write(_made(folder / form) / f"scan{suffix}", scene(points=60))


def _recordings(folder: Path) -> None:
    scans = [scene(i, 40) for i in range(3)]
    for compression in (None, "bz2", "lz4"):
        write_bag1(_made(folder / f"bag {compression}") / "a.bag", {"/points": scans}, compression)
    for storage in ("sqlite3", "mcap"):
        for compression in (None, "message", "storage" if storage == "mcap" else "file"):
            write_bag2(_made(folder / f"{storage} {compression}") / "a", {"/points": scans}, storage, compression)
    (alone,) = (folder / "mcap None" / "a").glob("*.mcap")
    (_made(folder / "mcap file") / "a.mcap").write_bytes(alone.read_bytes())
    for form in ("pcd ascii", "npz"):
        write_folder(_made(folder / f"folder {form}") / "scans", scans, form)


def _images(folder: Path) -> None:
    rng = np.random.default_rng(0)
    grey, colour = rng.integers(0, 255, (24, 32), np.uint8), rng.integers(0, 255, (24, 32, 3), np.uint8)
    kinds = {"deep png": grey.astype(np.uint16) * 257, "deep tiff": grey.astype(np.uint16) * 257, "deep pgm": grey * 9}
    kinds |= {"png": colour, "jpg": colour, "tiff": colour, "pgm": grey, "ppm": colour, "bmp": colour, "webp": colour}
    for form, image in kinds.items():
        assert cv2.imwrite(str(_made(folder / form) / f"image.{form.split()[-1]}"), image)


def _pairs(folder: Path) -> None:
    for side in ("left", "right"):
        inside = write_images(folder / "list" / side, ["a.png", "b.png"])
        text = "".join(f"{name}.png,{(FIRST_NS + i * 10**8) / 1e9:.6f}\n" for i, name in enumerate("ab"))
        (inside / "timestamps.txt").write_text(text)


_WRITERS: dict[str, Callable[[Path], None]] = {
    "cam": _cams,
    "rig": _rigs,
    "map": _maps,
    "detections": lambda folder: (_made(folder / "csv") / "d.csv").write_text(rows().text()) and None,
    "calibration": _calibrations,
    "pose": _poses,
    "local pose": _local_poses,
    "evidence": lambda folder: (_made(folder / "npz") / "evidence.npz").write_bytes(content()) and None,
    "contract": lambda folder: (_made(folder / "json") / "n.contract.json").write_text(json.dumps(CONTRACT)) and None,
    "model": _masks,
    "scan": _scans,
    "scans": _recordings,
    "image": _images,
    "pairs": _pairs,
}
