"""A scene as files: scans or images, messages, the lane map and the ground truth."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.messages.cam import CamLog
from tools.scenes.cameras import mistold, raw_rig
from tools.scenes.cams import EPOCH_NS
from tools.scenes.disparity import StereoCamera
from tools.scenes.places import Place
from tools.scenes.render import random_look, write_stereo
from tools.scenes.scene import Recorded, Scene
from tools.scenes.world import Edge, Line

CAM_HEADER = (
    "timestamp", "station_id", "latitude", "longitude", "altitude", "heading", "speed", "vehicle_length",
    "vehicle_width", "semi_major_95", "semi_minor_95", "ellipse_orientation",
)  # fmt: skip

TRUTH_STEP_S = 0.1

RENDERED_STEP = 2
"""Every second frame is rendered: 5 per second."""


def write_scene(scene: Scene, out: Path) -> None:
    """Write a data set: ``cam.csv``, ``map.osm``, ``truth.json``, and scans, or images with their calibration.

    Images take seconds each.
    """
    out.mkdir(parents=True, exist_ok=True)
    if isinstance(scene.sensor, StereoCamera):
        write_images(scene, out)
    else:
        write_scans(scene, out / scene.sensor_kind)
    write_cams(scene.messages, out / "cam.csv")
    write_map((*scene.site.lines, *scene.site.edges), scene.place, out / "map.osm")
    (out / "truth.json").write_text(json.dumps(truth(scene), indent=1))


def write_images(scene: Scene, out: Path, step: int = RENDERED_STEP) -> None:
    """Render a stereo camera's raw images of every ``step``-th frame, and write its calibration as ``stereo.yaml``."""
    camera, look = scene.sensor, random_look(np.random.default_rng(scene.seed))
    assert isinstance(camera, StereoCamera), scene.sensor_kind
    rig = raw_rig(np.random.default_rng([scene.seed, 8]), camera.size_px, camera.focal_px, camera.baseline_m)
    told = mistold(rig, camera.focal_error, camera.baseline_error, camera.turned_deg)
    stamps, times_s = scene.stamps_ns[::step].tolist(), scene.times_s[::step]
    write_stereo(scene.bodies, rig, scene.T_world_sensor, times_s, stamps, out, look, scene.seed, told, camera.apart_s)


def write_scans(scene: Scene, folder: Path) -> None:
    """Write every scan as a binary PCD file, named by its stamp in nanoseconds."""
    folder.mkdir(parents=True, exist_ok=True)
    recorded = Recorded(scene)
    for index, stamp_ns in enumerate(scene.stamps_ns.tolist()):
        scan = recorded.scan(index)
        columns = [scan.points, scan.intensity, scan.offset_s]
        (folder / f"{stamp_ns}.pcd").write_bytes(pcd(np.column_stack([each for each in columns if each is not None])))


def pcd(columns: FloatArray) -> bytes:
    """Return a PCD file with x, y, z, a fourth column as intensity, and a fifth as each point's time, ``t``."""
    names = ("x", "y", "z", "intensity", "t")[: columns.shape[1]]
    count = len(columns)
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        f"FIELDS {' '.join(names)}",
        f"SIZE {' '.join('4' for _ in names)}",
        f"TYPE {' '.join('F' for _ in names)}",
        f"COUNT {' '.join('1' for _ in names)}",
        f"WIDTH {count}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        "DATA binary",
    ]
    return "\n".join([*lines, ""]).encode() + columns.astype("<f4").tobytes()


def write_cams(log: CamLog, path: Path) -> None:
    """Write messages with the tool's own column names."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(CAM_HEADER)
        for i in range(len(log)):
            seconds, rest = divmod(int(log.stamps_ns[i]), 1_000_000_000)
            writer.writerow(
                [
                    f"{seconds}.{rest:09d}",
                    int(log.station_id[i]),
                    f"{log.latitude_deg[i]:.10f}",
                    f"{log.longitude_deg[i]:.10f}",
                    f"{log.altitude_m[i]:.2f}",
                    f"{log.heading_deg[i]:.6f}",
                    f"{log.speed_mps[i]:.4f}",
                    f"{log.length_m[i]:.4f}",
                    f"{log.width_m[i]:.4f}",
                    f"{log.semi_major_95_m[i]:.4f}",
                    f"{log.semi_minor_95_m[i]:.4f}",
                    f"{log.ellipse_orientation_deg[i]:.1f}",
                ]
            )


def write_map(lines: Sequence[Line | Edge], place: Place, path: Path) -> None:
    """Write lines as ways of an OSM file, in Lanelet2's format."""
    number = 0
    nodes, ways = [], []
    for line in lines:
        latitude, longitude = place.geodetic(line.xy)
        refs = []
        for lat, lon in zip(latitude.tolist(), longitude.tolist(), strict=True):
            number += 1
            nodes.append(f'  <node id="{number}" lat="{lat:.10f}" lon="{lon:.10f}"/>')
            refs.append(f'<nd ref="{number}"/>')
        number += 1
        tags = f'<tag k="type" v={quoteattr(line.kind)}/><tag k="subtype" v={quoteattr(line.subtype)}/>'
        ways.append(f'  <way id="{number}">{"".join(refs)}{tags}</way>')
    path.write_text("\n".join(['<?xml version="1.0"?>', '<osm version="0.6">', *nodes, *ways, "</osm>", ""]))


def truth(scene: Scene) -> dict[str, object]:
    """Return the contents of ``truth.json``: the vehicle's centre ten times a second, and the sensor's pose."""
    first, last = float(scene.times_s[0]) - 0.5, float(scene.times_s[-1]) + 0.5
    times = np.arange(first, last, TRUTH_STEP_S)
    track = scene.place.to_utm(scene.sender.track(times)[0])
    centres = [[EPOCH_NS / 1e9 + t, *xy] for t, xy in zip(times.tolist(), track.tolist(), strict=True)]
    entries: dict[str, object] = {
        "seed": scene.seed,
        "utm_epsg": scene.place.epsg,
        "cam_clock_offset_s": scene.cam_flaws.clock_offset_s,
        "station_id": int(scene.messages.stations()[0]),
        "axes": {"forward": scene.axes.forward, "up": scene.axes.up},
        "vehicle": {
            "length": scene.vehicle.length_m,
            "width": scene.vehicle.width_m,
            "height": scene.vehicle.height_m,
        },
        "vehicle_centres_utm": centres,
    }
    T = scene.T_utm_sensor.tolist()
    if isinstance(scene.sensor, StereoCamera):
        entries["stereo"] = {"T_world_camera_utm": T, "baseline": scene.sensor.baseline_m}
    else:
        entries["lidar"] = {scene.sensor_kind: {"T_world_lidar_utm": T}}
    return entries
