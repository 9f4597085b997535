"""A CAM log in words: how it was interpreted, before any calibration with it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from laci_stereo.core.errors import LaciError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.messages.cam import MAX_GAP_S, METRES_PER_DEG, CamLog, vehicle_track
from laci_stereo.core.messages.stations import world_around
from laci_stereo.io.cam.recording import CamRecording
from laci_stereo.io.stamps import iso_text

MOST_STATIONS = 5
"""Number of stations described. Vehicles in a car park may send too, as hundreds of stations; those that drove through
the scene are among the stations with most messages."""

MOST_CHECKED = 6000
"""Number of messages checked per station: those of ten minutes at 10 Hz. No vehicle is in view for longer, and an error
of the whole log shows in these."""


@dataclass(frozen=True)
class LogSummary:
    """The contents of a log in words.

    Attributes
    ----------
    text : str
        The log as a whole, its stations with most messages, and a line for each interpretation made in reading it.
    of_use : bool
        Whether a calibration could use at least one of its stations.
    """

    text: str
    of_use: bool


def summarise_log(recording: CamRecording, name: str) -> LogSummary:
    """Describe the contents of a log; ``name`` is what the text calls it."""
    lines, of_use = [*_whole(recording, name)], False
    stations = recording.log.stations()
    for station in stations[:MOST_STATIONS]:
        log = recording.log.of(station)
        its_use, found = _found(log)
        lines += [f"Station {station}", *_station(log), *(_line("  Check", words) for words in found)]
        of_use |= its_use
    if not of_use and (others := stations[MOST_STATIONS:]):
        of_use = any(_found(recording.log.of(station))[0] for station in others)
        lines.append(_line("Others", "one of them is of use: --station tells which" if of_use else "none is of use"))
    return LogSummary("\n".join([*lines, *(f"note: {note}" for note in recording.notes)]), of_use)


def _whole(recording: CamRecording, name: str) -> Iterator[str]:
    log = recording.log
    yield _line("Log", f"{name}: {recording.format}, {len(log)} messages")
    yield _line("Time", _span(log))
    reference = (
        "antenna; --cam-reference X,Y has to tell where on the vehicle that is"
        if recording.is_receiver
        else "centre of the vehicle's front side (ETSI); if the sender does not comply, --cam-reference"
    )
    yield _line("Positions", f"of the {reference}")
    stations = log.stations()
    first = ", ".join(str(station) for station in stations[:MOST_STATIONS])
    more = f" and {len(stations) - MOST_STATIONS} more" if len(stations) > MOST_STATIONS else ""
    yield _line("Stations", f"{len(stations)}: {first}{more}")


def _station(log: CamLog) -> Iterator[str]:
    yield _line("  Messages", f"{len(log)}, {_rate(log)}")
    yield _line("  Time", _span(log))
    yield _line("  Place", _place(log))
    yield _line("  Speed", _range(log.speed_mps, "m/s", 2))
    yield _line("  Vehicle", _sizes(log.length_m, log.width_m))
    yield _line("  Accuracy", f"{_sizes(log.semi_major_95_m, log.semi_minor_95_m)}, axes of the 95 % ellipse")


def _found(log: CamLog) -> tuple[bool, list[str]]:
    """Return whether a calibration could use one station's messages, and the remarks that it would make on them.

    Nothing is known of messages that are not checked (`MOST_CHECKED`), so they count as usable.
    """
    part = f" (of the first {MOST_CHECKED} messages)" if len(log) > MOST_CHECKED else ""
    log = log[np.arange(min(len(log), MOST_CHECKED))]
    located = np.count_nonzero(np.isfinite(log.latitude_deg) & np.isfinite(log.longitude_deg))
    if located < 2:
        return bool(part), [f"of no use{part}: {located} messages with a position; needed are at least 2"]
    try:
        track = vehicle_track(log, world_around(log), int(log.stamps_ns[0]))
    except LaciError as error:
        return bool(part), [f"of no use{part}: {error}"]
    found = [*dict.fromkeys((*track.objections, *track.remarks))]
    if not track.objections:
        found.append(f"{len(track.stamps_s)} of {len(log)} messages follow from one another by speed and heading")
    return True, [f"{words}{part}" for words in found]


def _line(label: str, text: str) -> str:
    return f"{label:<11}{text}"


def _span(log: CamLog) -> str:
    first, last = int(log.stamps_ns[0]), int(log.stamps_ns[-1])
    return f"{iso_text(first)} to {iso_text(last)}, {(last - first) / 1e9:.1f} s"


def _rate(log: CamLog) -> str:
    steps_s = np.diff(log.stamps_ns) / 1e9
    if len(steps_s) == 0:
        return "a single one"
    gaps = steps_s[steps_s > MAX_GAP_S]
    longest = f", the longest {gaps.max():.1f} s" if len(gaps) else ""
    return f"{1 / np.median(steps_s):.1f} per second (median), {len(gaps)} gaps over {MAX_GAP_S} s{longest}"


def _place(log: CamLog) -> str:
    log = log[np.isfinite(log.latitude_deg) & np.isfinite(log.longitude_deg)]
    if len(log) == 0:
        return "never sent"
    north_m = METRES_PER_DEG * np.diff(log.latitude_deg)
    east_m = METRES_PER_DEG * np.diff(log.longitude_deg) * np.cos(np.radians(log.latitude_deg[1:]))
    driven_m = float(np.hypot(north_m, east_m).sum())
    first, last = (f"{log.latitude_deg[i]:.7f}, {log.longitude_deg[i]:.7f}" for i in (0, -1))
    return f"{first} to {last}, {driven_m:.0f} m driven"


def _range(values: FloatArray, unit: str, digits: int) -> str:
    known = values[np.isfinite(values)]
    return f"{known.min():.{digits}f} to {known.max():.{digits}f} {unit}" if len(known) else "never sent"


def _sizes(length_m: FloatArray, width_m: FloatArray) -> str:
    """Return the medians of the known values of two sizes, as text."""
    known = [values[np.isfinite(values)] for values in (length_m, width_m)]
    return " x ".join(f"{np.median(values):.2f} m" if len(values) else "unknown" for values in known)
