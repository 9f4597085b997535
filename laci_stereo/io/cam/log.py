"""Logs of Cooperative Awareness Messages in any supported format, which is recognised by the file's content."""

from __future__ import annotations

from pathlib import Path

from laci_stereo.core.errors import CamError
from laci_stereo.io.cam.csv_log import read_cam_csv
from laci_stereo.io.cam.gpx_log import looks_like_xml, read_cam_gpx
from laci_stereo.io.cam.hex_log import looks_like_hex, read_cam_binary, read_cam_hex
from laci_stereo.io.cam.json_log import looks_like_json, read_cam_json
from laci_stereo.io.cam.nmea_log import looks_like_nmea, read_cam_nmea
from laci_stereo.io.cam.packet_capture import is_capture
from laci_stereo.io.cam.pcap_log import read_cam_capture
from laci_stereo.io.cam.recording import CamRecording
from laci_stereo.io.cam.rtklib_log import looks_like_rtklib, read_cam_rtklib
from laci_stereo.io.cam.uper import is_cam
from laci_stereo.io.file_content import BAG_MAGICS, begins_with, read_content
from laci_stereo.io.text_file import text_in

_TEXTS = (
    (looks_like_xml, read_cam_gpx),
    (looks_like_nmea, read_cam_nmea),
    (looks_like_hex, read_cam_hex),
    (looks_like_json, read_cam_json),
    (looks_like_rtklib, read_cam_rtklib),
)


def read_cam_log(path: Path) -> CamRecording:
    """Read a log of messages: CSV, packet capture, bag, hexadecimal lines, JSON, NMEA, GPX or RTKLIB's solutions.

    ``path`` is a file, which may be compressed by gzip, or the folder of a ROS 2 bag.

    Raises
    ------
    CamError
        If the file is in none of these formats, or holds no usable log.
    """
    if path.is_dir() and not any(
        entry.name == "metadata.yaml" or entry.suffix in (".mcap", ".db3") for entry in path.iterdir()
    ):
        raise CamError(f"{path} holds no .mcap or .db3 file; needed is a file, or a folder that ROS 2 recorded")
    if path.is_dir() or begins_with(path, BAG_MAGICS):
        return _read_bag(path)
    content = read_content(path, CamError)
    if is_capture(content):
        return read_cam_capture(path, content)
    if is_cam(content):
        return read_cam_binary(path, content)
    text = text_in(content, path, CamError)
    for fits, read in _TEXTS:
        if fits(text):
            return read(path, text)
    return read_cam_csv(path)


def _read_bag(path: Path) -> CamRecording:
    try:
        from laci_stereo.io.cam.bag_log import read_cam_bag
    except ImportError as problem:
        raise CamError(
            f"{path}: reading bags needs the extra 'bag' ({problem.name} is not installed); "
            "needed is pip install 'laci-stereo[bag]'"
        ) from problem
    return read_cam_bag(path)
