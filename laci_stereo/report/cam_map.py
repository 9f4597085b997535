"""A small map, north up, of the positions in a CAM log."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.frames import FloatArray, Raster
from laci_stereo.core.messages.cam import MAX_GAP_S, METRES_PER_DEG, CamLog
from laci_stereo.io.cam.recording import CamRecording
from laci_stereo.report.canvas import TEXT, Canvas, Entry
from laci_stereo.report.mapview import MARGIN_SHARE, MapView, draw_bar
from laci_stereo.report.style import BLACK, BLUE, GREY, PURPLE, SKY_BLUE, VERMILLION, WHITE, Colour, Stroke

SIZE = (1280, 960)
"""Width and height, pixels."""

_COLOURS: tuple[Colour, ...] = (BLUE, VERMILLION, PURPLE, SKY_BLUE, BLACK)
_LEAST_EXTENT_M = 5.0
_DOT, _LINE = 2.5, 2.0
BAR_SHARE = 0.25


def draw_log(recording: CamRecording) -> Raster:
    """Draw the messages' positions, with one colour for each of the stations with most messages and grey for the rest.

    At least one message has a position. The picture has the shape (h, w, 3), uint8, in blue, green, red.
    """
    canvas = Canvas(np.full((SIZE[1], SIZE[0], 3), 255, dtype=np.uint8), WHITE)
    log = recording.log[np.isfinite(recording.log.latitude_deg) & np.isfinite(recording.log.longitude_deg)]
    xy = _metres(log)
    view = _view(xy)
    named = log.stations()[: len(_COLOURS)]
    others = ~np.isin(log.station_id, named)
    canvas.specks(view.pixels(xy[others]), GREY)
    entries = [Entry("others", "dot", Stroke(GREY, _DOT))] if others.any() else []
    for station, colour in reversed(list(zip(named, _COLOURS, strict=False))):
        of_station = log.station_id == station
        gaps = np.diff(log.stamps_ns[of_station] / 1e9) > MAX_GAP_S
        for piece in np.split(xy[of_station], np.flatnonzero(gaps) + 1):
            canvas.lines([view.pixels(piece)], Stroke(colour, _LINE))
        canvas.dots(view.pixels(xy[of_station]), colour, _DOT)
        entries.insert(0, Entry(f"station {station}, {int(of_station.sum())} messages", "dot", Stroke(colour, _DOT)))
    margin = 1.5 * TEXT * canvas.unit_px
    canvas.legend(entries, (margin, margin), BLACK)
    draw_bar(canvas, view, (margin, SIZE[1] - margin), BAR_SHARE, ", north is up")
    return canvas.image


def _metres(log: CamLog) -> FloatArray:
    """Return metres east and north of the median position, shape (n, 2): accurate enough for a picture of some km."""
    longitude = np.degrees(np.unwrap(np.radians(log.longitude_deg)))
    latitude_deg, longitude_deg = np.median(log.latitude_deg), np.median(longitude)
    east = (longitude - longitude_deg) * np.cos(np.radians(latitude_deg))
    return METRES_PER_DEG * np.column_stack([east, log.latitude_deg - latitude_deg])


def _view(xy: FloatArray) -> MapView:
    low, high = xy.min(axis=0), xy.max(axis=0)
    extent = np.maximum((1 + 2 * MARGIN_SHARE) * (high - low), _LEAST_EXTENT_M)
    return MapView((low + high) / 2, float((np.array(SIZE) / extent).min()), (float(SIZE[0]), float(SIZE[1])))
