"""LiDARs: directions and times of their beams, and the returns of beams that meet a surface."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from tools.scenes.geometry import Hits, Material, RayCaster

LidarName = Literal["lidar_8", "lidar_16", "lidar_32", "lidar_64", "lidar_128", "lidar_rosette"]
LIDARS: tuple[LidarName, ...] = get_args(LidarName)

Turning = Literal["clockwise", "counter-clockwise", "at once"]
TURNINGS: tuple[Turning, ...] = get_args(Turning)

REFLECTIVITY = {
    Material.ROAD: 0.12,
    Material.PAINT: 0.5,
    Material.KERB: 0.3,
    Material.GRASS: 0.4,
    Material.WALL: 0.35,
    Material.FOLIAGE: 0.4,
    Material.METAL: 0.3,
    Material.CAR_PAINT: 0.3,
    Material.GLASS: 0.01,
    Material.TYRE: 0.05,
    Material.CLOTH: 0.3,
    Material.LAMP: 0.5,
}
"""Diffuse reflectivity at 905 nm (asphalt, concrete, grass, leaves: ECOSTRESS spectral library; tyres and glass: almost
none)."""

PAINT_REFLECTIVITY = (0.05, 0.7)
"""Reflectivity of car paint, from black to white (Pandey et al., and the makers' colour panels)."""


ROUGH = (Material.ROAD, Material.KERB, Material.GRASS, Material.WALL, Material.FOLIAGE, Material.TYRE, Material.CLOTH)
"""Rough surfaces, which reflect more at a grazing angle than cos(angle): Oren and Nayar 1994."""

ROUGH_COS, ROUGH_SIN2 = 0.784, 0.33
"""A and B of that model for a roughness of 0.5 rad, viewed from the direction of the light: A cos + B sin^2."""


SPECKLE = 0.15
"""Relative standard deviation of an intensity: coherent light on a rough surface, averaged over few speckles."""

DROP = 0.05
"""Reflectivity of a raindrop."""


@dataclass(frozen=True)
class Lidar:
    """A LiDAR; its own axes are x forward, y left, z up.

    Attributes
    ----------
    name : LidarName
    azimuth_rad, elevation_rad : ndarray, shape (n,)
        Directions of the beams of a frame; of the first frame if the pattern does not repeat.
    offset_s : ndarray, shape (n,)
        Time at which each beam is fired, after the frame's stamp.
    layer : ndarray of int64, shape (n,)
        Index of the laser that fires it.
    period_s : float
        Time between frames.
    range_sigma_m : float
        Standard deviation of a range.
    pointing_rad : tuple of float
        Standard deviation of the return's direction within the beam's width, horizontally and vertically.
    reach_m : float
        Half of the beams that meet a surface of 10 % reflectivity perpendicularly at this distance are returned.
    repeats : bool
        All frames have the same beams.
    """

    name: LidarName
    azimuth_rad: FloatArray
    elevation_rad: FloatArray
    offset_s: FloatArray
    layer: IntArray
    period_s: float
    range_sigma_m: float
    pointing_rad: tuple[float, float]
    reach_m: float
    repeats: bool = True

    def at_rate(self, frame_rate_hz: float) -> Lidar:
        """Return the scanner at another frame rate.

        A faster one fires as many beams per second: it leaves out columns, or ends its pattern earlier. A slower one
        scans at its usual speed, and pauses between frames.
        """
        period_s = 1.0 / frame_rate_hz
        share = min(period_s / self.period_s, 1.0)
        if self.repeats:
            column = np.unique(self.azimuth_rad, return_inverse=True)[1]
            kept = np.floor((column + 1) * share) > np.floor(column * share)
            offset_s = self.offset_s * share
        else:
            kept, offset_s = self.offset_s < period_s, self.offset_s
        return replace(
            self,
            azimuth_rad=self.azimuth_rad[kept],
            elevation_rad=self.elevation_rad[kept],
            offset_s=offset_s[kept],
            layer=self.layer[kept],
            period_s=period_s,
        )

    def beginning(self, begin_deg: float) -> Lidar:
        """Return the scanner with its scans cut at another azimuth than behind, if its field of view is all around."""
        if not self.repeats or self.field_rad[0] < 3.0:
            return self
        turned = (np.radians(begin_deg) - self.azimuth_rad) % (2 * np.pi)
        order = np.argsort(turned, kind="stable")
        return replace(
            self,
            azimuth_rad=self.azimuth_rad[order],
            elevation_rad=self.elevation_rad[order],
            offset_s=turned[order] / (2 * np.pi) * self.period_s,
            layer=self.layer[order],
        )

    def turning(self, way: Turning) -> Lidar:
        """Return the scanner with its beams fired in this order; one whose pattern does not repeat keeps its own."""
        if not self.repeats or way == "clockwise":
            return self
        return replace(self, offset_s=0.0 * self.offset_s if way == "at once" else self.offset_s.max() - self.offset_s)

    @cached_property
    def field_rad(self) -> tuple[float, float, float]:
        """Half the width of the field of view, and its lowest and highest elevation."""
        return (
            float(np.abs(self.azimuth_rad).max()),
            float(self.elevation_rad.min()),
            float(self.elevation_rad.max()),
        )

    def sees(self, points: FloatArray) -> BoolArray:
        """Return which points, shape (n, 3), in the sensor's own axes, are in the field of view."""
        half, low, high = self.field_rad
        azimuth = np.arctan2(points[:, 1], points[:, 0])
        elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
        seen: BoolArray = (np.abs(azimuth) <= half) & (elevation >= low) & (elevation <= high)
        return seen

    def beams(self, index: int) -> tuple[FloatArray, FloatArray]:
        """Return azimuth and elevation of the beams of frame ``index``."""
        if self.repeats:
            return self.azimuth_rad, self.elevation_rad
        return _rosette(self.offset_s + index * self.period_s)


def lidar(name: LidarName) -> Lidar:
    """Return a scanner like a commercial one; the figures are the data sheets'.

    ============= ============================ ============================================================
    lidar_8       SICK LD-MRS, 8 layers        6.4 deg, 0.25 deg, 12.5 Hz, 0.1 m (1 sigma, statistical),
                                               30 m at 10 %, beam 0.08 x 0.8 deg
    lidar_16      Velodyne VLP-16              +-15 deg, 0.2 deg at 10 Hz, 3 cm, 50 m at 10 %, 3 x 1.5 mrad
    lidar_32      Velodyne HDL-32E             -30.7 to 10.7 deg, 0.16 deg, 2 cm, 60 m at 10 %, 2.8 x 1.4 mrad
    lidar_64      Velodyne HDL-64E S3          -24.9 to 2 deg, 0.17 deg, 2 cm, 50 m at 10 %, 2 mrad
    lidar_128     Ouster OS1-128               +-22.5 deg, 1024 columns, 1 to 2 cm, 90 m at 10 %, 3 mrad
    lidar_rosette Livox Horizon                81.7 x 25.1 deg, 240,000 points/s, 2 cm, 90 m at 10 %,
                                               0.03 x 0.28 deg
    ============= ============================ ============================================================

    The direction of a return is uniformly distributed over the beam's width: its standard deviation is width /
    sqrt(12). The tall beam of the LD-MRS is limited by the layers' own width, a quarter of it, in the same way.
    """
    mrad = 1e-3
    if name == "lidar_8":
        beam = (float(np.radians(0.08)), float(np.radians(0.8)) / 4)
        return _spinning(name, np.linspace(-2.8, 2.8, 8), 0.25, 100.0, 0.08, 0.1, beam, 30.0)
    if name == "lidar_16":
        return _spinning(name, np.linspace(-15, 15, 16), 0.2, 360.0, 0.1, 0.03, (3 * mrad, 1.5 * mrad), 50.0)
    if name == "lidar_32":
        return _spinning(name, np.linspace(-30.67, 10.67, 32), 0.16, 360.0, 0.1, 0.02, (2.8 * mrad, 1.4 * mrad), 60.0)
    if name == "lidar_64":
        return _spinning(name, np.linspace(-24.9, 2.0, 64), 0.17, 360.0, 0.1, 0.02, (2 * mrad, 2 * mrad), 50.0)
    if name == "lidar_128":
        return _spinning(name, np.linspace(-22.5, 22.5, 128), 360 / 1024, 360.0, 0.1, 0.015, (3 * mrad, 3 * mrad), 90.0)
    offset = np.arange(24_000) / 240_000
    azimuth, elevation = _rosette(offset)
    spread = (float(np.radians(0.28)) / np.sqrt(12), float(np.radians(0.03)) / np.sqrt(12))
    layer = np.zeros(len(offset), dtype=np.int64)
    return Lidar(name, azimuth, elevation, offset, layer, 0.1, 0.02, spread, 90.0, repeats=False)


def _spinning(
    name: LidarName,
    layers_deg: FloatArray,
    step_deg: float,
    width_deg: float,
    period_s: float,
    sigma_m: float,
    beam_rad: tuple[float, float],
    reach_m: float,
) -> Lidar:
    """Return a scanner that rotates clockwise, seen from above, starting at the left border or behind."""
    azimuth = np.radians(np.arange(width_deg / 2 - step_deg / 2, -width_deg / 2, -step_deg))
    fired = (azimuth[0] - azimuth) / (2 * np.pi) * period_s
    a, e = np.meshgrid(azimuth, np.radians(layers_deg), indexing="ij")
    layer = np.tile(np.arange(len(layers_deg)), len(azimuth))
    spread = (beam_rad[0] / np.sqrt(12), beam_rad[1] / np.sqrt(12))
    times = np.repeat(fired, len(layers_deg))
    return Lidar(name, a.ravel(), e.ravel(), times, layer, period_s, sigma_m, spread, reach_m)


def _rosette(times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a beam's direction after two counter-rotating prisms (Risley): it fills an ellipse over time."""
    one, two = 2 * np.pi * 116.7 * times_s, -2 * np.pi * 77.2 * times_s
    across, up = np.radians(81.7) / 4, np.radians(25.1) / 4
    azimuth: FloatArray = across * (np.cos(one) + np.cos(two))
    return azimuth, up * (np.sin(one) + np.sin(two))


@dataclass(frozen=True)
class LidarFlaws:
    """How scans differ from the truth.

    Attributes
    ----------
    noise : float
        Scales the noise of ranges.
    rain : float
        Fraction of the beams that are returned by a drop in front of the scanner.
    point_times : bool
        Scans contain each point's own time.
    bias_m : float
        Offset of all ranges; makers specify that it is below about the noise, and a quarter of that is usual.
    layer_sigma_m : float
        Standard deviation of the lasers' own offsets (Glennie and Lichti 2010: 0.5 to 1.5 cm uncalibrated).
    """

    noise: float = 1.0
    rain: float = 0.0
    point_times: bool = True
    bias_m: float = 0.0
    layer_sigma_m: float = 0.0


@dataclass(frozen=True)
class Swept:
    """One frame of a scanner.

    Attributes
    ----------
    points : ndarray, shape (n, 3)
        In the scanner's own axes, x forward, y left, z up.
    offset_s : ndarray, shape (n,)
    body : ndarray of int64, shape (n,)
        Index of the body that each point is on; -1 for rain.
    intensity : ndarray, shape (n,)
        255 is a white surface met perpendicularly, at any distance, as scanners report it.
    """

    points: FloatArray
    offset_s: FloatArray
    body: IntArray
    intensity: FloatArray


def unit(azimuth_rad: FloatArray, elevation_rad: FloatArray) -> FloatArray:
    """Return unit vectors, shape (n, 3), x forward, y left, z up."""
    flat = np.cos(elevation_rad)
    return np.column_stack([flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(elevation_rad)])


def sweep(
    scanner: Lidar,
    flaws: LidarFlaws,
    caster: RayCaster,
    T_world_scanner: FloatArray,
    index: int,
    seed: int,
    first_s: float = 0.0,
) -> Swept:
    """Simulate frame ``index``.

    Parameters
    ----------
    scanner : Lidar
    flaws : LidarFlaws
    caster : RayCaster
    T_world_scanner : ndarray, shape (4, 4)
        Maps from the scanner's own axes.
    index : int
    seed : int
    first_s : float
        Time at which the first frame begins.
    """
    rng = np.random.default_rng([seed, index])
    azimuth, elevation = scanner.beams(index)
    n = len(azimuth)
    horizontal, vertical = (spread * np.sqrt(12) * rng.uniform(-0.5, 0.5, n) for spread in scanner.pointing_rad)
    true = unit(azimuth + horizontal / np.cos(elevation), elevation + vertical) @ T_world_scanner[:3, :3].T
    times = first_s + index * scanner.period_s + scanner.offset_s
    hits = caster.sweep(T_world_scanner[:3, 3], true, times)
    reflected = _reflected(caster, hits, true, seed)
    returned = rng.random(n) < _returned(scanner, hits, reflected)
    lasers = np.random.default_rng([seed, 7]).normal(size=int(scanner.layer.max()) + 1)
    range_m = hits.distance_m + flaws.noise * scanner.range_sigma_m * rng.normal(size=n)
    range_m = range_m + flaws.bias_m + flaws.layer_sigma_m * lasers[scanner.layer]
    drops = rng.random(n) < flaws.rain
    # Back-scatter of drops decreases with the square of the distance (Goodin et al. 2019): most are near.
    range_m = np.where(drops, np.minimum(1.0 / rng.uniform(0.05, 1.0, n), range_m), range_m)
    keep = (returned | drops) & (range_m > 0.5)
    points = unit(azimuth[keep], elevation[keep]) * range_m[keep, None]
    speckle = 1.0 + SPECKLE * np.random.default_rng([seed, index, 13]).normal(size=n)
    intensity = np.clip(255.0 * np.where(drops, DROP, reflected) * speckle, 0.0, 255.0).round()
    body = np.where(drops[keep], -1, hits.body[keep])
    return Swept(points, scanner.offset_s[keep], body, intensity[keep])


def _reflected(caster: RayCaster, hits: Hits, directions: FloatArray, seed: int) -> FloatArray:
    """Return the fraction of light that a surface reflects, relative to a white one met perpendicularly, shape (n,)."""
    met = np.flatnonzero(hits.body >= 0)
    body = hits.body[met]
    material = caster.materials[caster.faces(hits)[met]]
    table = np.array([REFLECTIVITY[material] for material in Material])
    colour = np.random.default_rng([seed, 11]).uniform(*PAINT_REFLECTIVITY, len(caster.bodies))
    reflectivity = np.where(material == Material.CAR_PAINT, colour[body], table[material])
    cosine = np.abs(np.einsum("ij,ij->i", hits.normal[met], directions[met]))
    rough = np.array([kind in ROUGH for kind in Material])[material]
    cosine = np.where(rough, ROUGH_COS * cosine + ROUGH_SIN2 * (1 - cosine**2), cosine)
    reflected = np.zeros(len(hits.body))
    reflected[met] = reflectivity * cosine
    return reflected


def _returned(scanner: Lidar, hits: Hits, reflected: FloatArray) -> FloatArray:
    """Return the probability that a beam is returned, by the received power: reflectivity * cos(angle) / distance^2."""
    power = reflected / 0.1 * (scanner.reach_m / hits.distance_m) ** 2
    # One half at the threshold; the detector's noise blurs it over a factor of about two.
    return power**3 / (1.0 + power**3)
