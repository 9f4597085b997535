"""The messages of a vehicle: Cooperative Awareness Messages with the flaws of real ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from laci_stereo.core.frames import FloatArray, rotate_xy, wrap
from laci_stereo.core.messages.cam import CamLog
from tools.scenes.places import Place
from tools.scenes.traffic import Mover

EPOCH_NS = 1_760_000_000_000_000_000
"""Unix time of a scene's time zero, by the sensor's clock."""

ReceiverName = Literal["exact", "rtk", "rtk_float", "dgnss", "gnss"]

Rounding = Literal["none", "nearest", "up"]

NINETY_FIVE = float(np.sqrt(-2 * np.log(0.05)))
"""Semi-axis of the 95 % ellipse of two equal normal variables, in standard deviations: 2.45."""

STANDING_MPS = 0.1


@dataclass(frozen=True)
class Receiver:
    """Errors of a position, per axis; the correlated part is a first-order Gauss-Markov process.

    Attributes
    ----------
    white_m, correlated_m, correlation_s : float
    """

    white_m: float
    correlated_m: float
    correlation_s: float


def receiver(name: ReceiverName) -> Receiver:
    """Return the errors of a class of receivers.

    RTK with fixed ambiguities: 1 cm + 1 ppm (data sheets of u-blox ZED-F9P and Septentrio mosaic); float: decimetres;
    DGNSS 0.4 to 0.6 m; single-point 1.5 m CEP. Multipath and atmospheric errors stay correlated for half a minute to
    minutes (Rankin, ION GPS-94; Roberts et al., 2002); white noise of the tracking loops is added to them.
    """
    if name == "exact":
        return Receiver(0.0, 0.0, 1.0)
    if name == "rtk":
        return Receiver(0.005, 0.012, 30.0)
    if name == "rtk_float":
        return Receiver(0.02, 0.20, 60.0)
    return Receiver(0.05, 0.5, 120.0) if name == "dgnss" else Receiver(0.1, 1.3, 300.0)


@dataclass(frozen=True)
class CamFlaws:
    """How messages differ from the truth.

    Attributes
    ----------
    receiver : ReceiverName
    rate_hz : float
        Fixed rate; 0 triggers by the rules of ETSI EN 302 637-2: 4 deg, 4 m or 0.5 m/s of change, 0.1 to 1 s.
    loss : float
        Fraction of the messages that are lost.
    clock_offset_s : float
        The messages' clock minus the sensor's.
    heading_sigma_deg : float
        RTK with two antennas 1 m apart: 0.2 to 0.4 deg; from Doppler at 10 m/s: 0.3 deg.
    heading_of : {"body", "front"}
        Direction of motion of the rear axle, or of the reference point at the front, which differs in bends.
    heading_lag_s : float
        Time by which headings are older than the positions beside them.
    speed_sigma_mps : float
        0.05 m/s (u-blox ZED-F9P).
    quantised : bool
        Fields are rounded to ETSI's steps: 1e-7 deg, 0.1 deg, 0.01 m/s, 1 ms; altitude 0.01 m.
    rounding : {"none", "nearest", "up"}
        Rounding of length and width to 0.1 m.
    over_mirrors : bool
        The width includes the mirrors, as in the vehicle papers of some countries.
    lever_m : tuple of float
        Error of the antenna's measured position on the vehicle, forward and left.
    """

    receiver: ReceiverName = "rtk"
    rate_hz: float = 10.0
    loss: float = 0.0
    clock_offset_s: float = 0.0
    heading_sigma_deg: float = 0.2
    heading_of: Literal["body", "front"] = "body"
    heading_lag_s: float = 0.0
    speed_sigma_mps: float = 0.05
    quantised: bool = True
    rounding: Rounding = "nearest"
    over_mirrors: bool = False
    lever_m: tuple[float, float] = (0.0, 0.0)


FLAWLESS = CamFlaws(
    receiver="exact", heading_sigma_deg=0.0, speed_sigma_mps=0.0, quantised=False, rounding="none"
)  # fmt: skip
"""Messages that are exact."""


def cam_log(
    mover: Mover,
    place: Place,
    flaws: CamFlaws,
    span_s: tuple[float, float],
    station: int,
    mirror_width_m: float,
    rng: np.random.Generator,
) -> CamLog:
    """Return the messages of one vehicle.

    Parameters
    ----------
    mover : Mover
    place : Place
    flaws : CamFlaws
    span_s : tuple of float
        First and last time, by the sensor's clock.
    station : int
    mirror_width_m : float
        The vehicle's width including its mirrors.
    rng : Generator
    """
    times = _sent(mover, flaws, span_s, rng)
    centre, yaw = mover.track(times)
    front = np.array([mover.length_m / 2, 0.0])
    reference = centre + rotate_xy(yaw, np.tile(front + flaws.lever_m, (len(times), 1)))
    kind = receiver(flaws.receiver)
    reference = reference + _wandering(kind, times, rng) + kind.white_m * rng.normal(size=(len(times), 2))
    latitude, longitude = place.geodetic(reference)
    speed = np.abs(mover.drive.speed(times) + flaws.speed_sigma_mps * rng.normal(size=len(times)))
    heading = place.heading_deg(centre, _direction(mover, flaws, times))
    heading = heading + flaws.heading_sigma_deg * rng.normal(size=len(times))
    # ETSI's smallest semi-axis is 1 cm.
    semi = np.full(len(times), max(NINETY_FIVE * float(np.hypot(kind.white_m, kind.correlated_m)), 0.01))
    width = mirror_width_m if flaws.over_mirrors else mover.width_m
    log = CamLog(
        EPOCH_NS + np.round((times + flaws.clock_offset_s) * 1e9).astype(np.int64),
        np.full(len(times), station, dtype=np.int64),
        latitude,
        longitude,
        heading % 360.0,
        speed,
        np.full(len(times), 560.0),
        np.full(len(times), _rounded(mover.length_m, flaws.rounding)),
        np.full(len(times), _rounded(width, flaws.rounding)),
        semi,
        semi,
        np.zeros(len(times)),
    )
    return _quantised(log) if flaws.quantised else log


def together(logs: Sequence[CamLog]) -> CamLog:
    """Return the messages of several stations in chronological order."""
    order = np.argsort(np.concatenate([log.stamps_ns for log in logs]), kind="stable")
    return logs[0].joined(*logs[1:])[order]


def _sent(mover: Mover, flaws: CamFlaws, span_s: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """Return the times of the messages that are received."""
    period = 0.1 if flaws.rate_hz == 0.0 else 1.0 / flaws.rate_hz
    times = np.arange(span_s[0] + rng.uniform(0.0, period), span_s[1], period)
    if flaws.rate_hz == 0.0:
        times = times[_triggered(mover, flaws, times)]
    return times[rng.random(len(times)) >= flaws.loss]


def _triggered(mover: Mover, flaws: CamFlaws, times_s: FloatArray) -> list[int]:
    """Return the indices of the messages that are sent: those whose contents have changed since the last one."""
    xy, _ = mover.track(times_s)
    heading = _direction(mover, flaws, times_s)
    speed = mover.drive.speed(times_s)
    sent = [0]
    for index in range(1, len(times_s)):
        last = sent[-1]
        changed = (
            abs(float(wrap(heading[index] - heading[last]))) > np.radians(4.0)
            or float(np.hypot(*(xy[index] - xy[last]))) > 4.0
            or abs(speed[index] - speed[last]) > 0.5
        )
        if changed or times_s[index] - times_s[last] > 1.0 - 1e-6:
            sent.append(index)
    return sent


def _wandering(kind: Receiver, times_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return a Gauss-Markov process in two axes, stationary from the first message on, shape (n, 2)."""
    noise = rng.normal(size=(len(times_s), 2))
    wandered = np.empty((len(times_s), 2))
    for index in range(len(times_s)):
        kept = 0.0 if index == 0 else float(np.exp(-(times_s[index] - times_s[index - 1]) / kind.correlation_s))
        before = wandered[index - 1] if index else 0.0
        wandered[index] = kept * before + kind.correlated_m * np.sqrt(1 - kept**2) * noise[index]
    return wandered


def _direction(mover: Mover, flaws: CamFlaws, times_s: FloatArray) -> FloatArray:
    """Return the direction of motion, which is reversed when the vehicle reverses, and kept while it is stationary."""
    times_s = times_s - flaws.heading_lag_s
    _, yaw = mover.track(times_s)
    speed = mover.drive.speed(times_s)
    direction = np.where(speed < 0.0, yaw + np.pi, yaw)
    if flaws.heading_of == "front":
        direction = direction + np.arctan((mover.length_m / 2 - mover.rear_axle_m) * mover.drive.curvature(times_s))
    moving = np.abs(speed) >= STANDING_MPS
    last = np.maximum.accumulate(np.where(moving, np.arange(len(times_s)), 0))
    return direction[last]


def _rounded(metres: float, rounding: Rounding) -> float:
    if rounding == "none":
        return metres
    steps = np.ceil(metres * 10 - 1e-9) if rounding == "up" else np.round(metres * 10)
    return float(steps) / 10


def _quantised(log: CamLog) -> CamLog:
    return replace(
        log,
        stamps_ns=(log.stamps_ns + 500_000) // 1_000_000 * 1_000_000,
        latitude_deg=log.latitude_deg.round(7),
        longitude_deg=log.longitude_deg.round(7),
        heading_deg=log.heading_deg.round(1) % 360.0,
        speed_mps=log.speed_mps.round(2),
        semi_major_95_m=np.ceil(log.semi_major_95_m * 100) / 100,
        semi_minor_95_m=np.ceil(log.semi_minor_95_m * 100) / 100,
    )
