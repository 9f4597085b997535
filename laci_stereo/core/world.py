"""The world frame, in true metres around a whole-metre UTM point, and conversions from and to geodetic positions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pyproj import CRS, Proj, Transformer
from pyproj.exceptions import CRSError

from laci_stereo.core.errors import CamError, SettingError
from laci_stereo.core.frames import BoolArray, FloatArray

MAX_ZONES_APART = 2
"""Largest difference of zone numbers: a grid may be extended into a neighbouring zone, whose number differs by two on
Svalbard."""

BAND_DEG = 8.0
"""Height of a latitude band, by which a grid may be extended across the equator."""


@dataclass(frozen=True)
class World:
    """A metric frame on the map: UTM = ``origin_utm`` + ``grid_scale`` * world.

    Attributes
    ----------
    crs : str
        The UTM zone, for example ``EPSG:32632``.
    origin_utm : tuple of float
        Easting and northing of the origin, whole metres.
    grid_scale : float
        UTM's point scale at the origin (0.9996 to 1.0010): grid metres per true metre.
    """

    crs: str
    origin_utm: tuple[float, float]
    grid_scale: float

    @classmethod
    def around(cls, latitude_deg: float, longitude_deg: float, crs: str | None = None) -> World:
        """Return the frame around a position, in its own UTM zone and hemisphere unless ``crs`` names another.

        Raises
        ------
        CamError
            If UTM is not defined there (beyond 84 deg north or 80 deg south).
        SettingError
            If ``crs`` is not a UTM zone known to PROJ, if its number differs from that of the position's zone by more
            than two, or if it is of the other hemisphere and the position is more than `BAND_DEG` from the equator.
        """
        code = _own_utm(latitude_deg, longitude_deg) if crs is None else _checked_utm(crs, latitude_deg, longitude_deg)
        proj = Proj(code)
        east, north = proj(longitude_deg, latitude_deg)
        scale = float(proj.get_factors(longitude_deg, latitude_deg).meridional_scale)
        return cls(code, (float(round(east)), float(round(north))), scale)

    # Before its version 3.7.2, pyproj treats arrays of one element as scalars; lists are not affected.

    @cached_property
    def _transformer(self) -> Transformer:
        return Transformer.from_crs("EPSG:4326", self.crs, always_xy=True)

    @cached_property
    def _proj(self) -> Proj:
        return Proj(self.crs)

    def from_geodetic(self, latitude_deg: FloatArray, longitude_deg: FloatArray) -> FloatArray:
        """Map WGS84 positions, shapes (n,), to x and y in the world frame, shape (n, 2)."""
        east, north = self._transformer.transform(longitude_deg.tolist(), latitude_deg.tolist())
        return self.from_utm(np.column_stack([east, north]))

    def from_utm(self, utm: FloatArray) -> FloatArray:
        """Map UTM easting and northing, shape (n, 2), to x and y in the world frame, shape (n, 2)."""
        xy: FloatArray = (utm - np.array(self.origin_utm)) / self.grid_scale
        return xy

    def to_utm(self, xy: FloatArray) -> FloatArray:
        """Map x and y in the world frame, shape (n, 2), to UTM easting and northing, shape (n, 2)."""
        utm: FloatArray = np.array(self.origin_utm) + self.grid_scale * xy
        return utm

    def to_geodetic(self, xy: FloatArray) -> FloatArray:
        """Map x and y in the world frame, shape (n, 2), to WGS84 latitude and longitude in degrees, shape (n, 2)."""
        utm = self.to_utm(xy)
        east, north = utm.T.tolist()
        longitude, latitude = self._transformer.transform(east, north, direction="INVERSE")
        return np.column_stack([latitude, longitude])

    def holds(self, latitude_deg: FloatArray, longitude_deg: FloatArray) -> BoolArray:
        """Return which positions can be mapped, shape (n,): not those that are missing or half the Earth away."""
        told = np.isfinite(latitude_deg) & np.isfinite(longitude_deg)
        latitude, longitude = np.where(told, latitude_deg, 0.0), np.where(told, longitude_deg, 0.0)
        yaw = self.yaw_from_heading(np.zeros(len(told)), latitude, longitude)
        held: BoolArray = told & np.isfinite(self.from_geodetic(latitude, longitude)).all(axis=1) & np.isfinite(yaw)
        return held

    def yaw_from_heading(
        self, heading_deg: FloatArray, latitude_deg: FloatArray, longitude_deg: FloatArray
    ) -> FloatArray:
        """Convert headings (clockwise from true north, deg) to yaw (counter-clockwise from grid east, rad), as (n,)."""
        convergence_deg = self._proj.get_factors(longitude_deg.tolist(), latitude_deg.tolist()).meridian_convergence
        yaw: FloatArray = np.radians(90.0 - heading_deg + np.asarray(convergence_deg))
        return yaw

    def grid_from_sensor(self, T_world_sensor: FloatArray, centre_world: FloatArray) -> FloatArray:
        """Return the transform into grid metres from the origin, shape (4, 4): rigid, and exact at ``centre_world``.

        The grid's scale cannot be part of a rigid transform, so it is exact only where that matters: around the track.
        """
        T: FloatArray = T_world_sensor.copy()
        T[:2, 3] += (self.grid_scale - 1.0) * centre_world[:2]
        return T

    def utm_from_sensor(self, T_world_sensor: FloatArray, centre_world: FloatArray) -> FloatArray:
        """Return the transform of `grid_from_sensor` into UTM coordinates, shape (4, 4)."""
        T = self.grid_from_sensor(T_world_sensor, centre_world)
        T[:2, 3] += self.origin_utm
        return T


def _own_utm(latitude_deg: float, longitude_deg: float) -> str:
    if not -80.0 <= latitude_deg <= 84.0:
        raise CamError(f"latitude is {latitude_deg:.3f} deg; UTM is defined between -80 and 84 deg")
    return f"EPSG:{326 if latitude_deg >= 0.0 else 327}{_utm_zone(latitude_deg, longitude_deg):02d}"


def _utm_zone(latitude_deg: float, longitude_deg: float) -> int:
    """Return the zone's number: zones are 6 deg wide from 180 deg west, except in southern Norway and Svalbard."""
    longitude_deg = (longitude_deg + 180.0) % 360.0 - 180.0
    if 56.0 <= latitude_deg < 64.0 and 3.0 <= longitude_deg < 6.0:
        return 32
    if latitude_deg >= 72.0 and 0.0 <= longitude_deg < 42.0:
        return 31 + 2 * int((longitude_deg + 3.0) // 12.0)
    return int(longitude_deg // 6.0) + 31


def utm_code(crs: str) -> str:
    """Return the EPSG code of a UTM zone, for example ``EPSG:32632``.

    Raises
    ------
    SettingError
        If ``crs`` is not a UTM zone known to PROJ.
    """
    return f"EPSG:{_utm(crs).to_epsg()}"


def _utm(crs: str) -> CRS:
    try:
        parsed = CRS.from_user_input(crs)
    except CRSError as error:
        raise SettingError(
            f"coordinate system {crs!r} is not known to PROJ; needed is a UTM zone such as EPSG:32632"
        ) from error
    if parsed.utm_zone is None or parsed.to_epsg() is None:
        raise SettingError(f"coordinate system {crs!r} is {parsed.name}; needed is a UTM zone such as EPSG:32632")
    return parsed


def _checked_utm(crs: str, latitude_deg: float, longitude_deg: float) -> str:
    zone = str(_utm(crs).utm_zone)
    if abs(latitude_deg) > BAND_DEG and (zone[-1] == "N") != (latitude_deg > 0.0):
        raise SettingError(
            f"coordinate system {crs!r} is of the other hemisphere than the latitude, which is {latitude_deg:.3f} deg; "
            f"needed is one like {_own_utm(latitude_deg, longitude_deg)}"
        )
    given, own = int(zone[:-1]), _utm_zone(0.0, longitude_deg)
    if min((given - own) % 60, (own - given) % 60) > MAX_ZONES_APART:
        raise SettingError(
            f"coordinate system {crs!r} is UTM zone {given}, but the longitude is {longitude_deg:.3f} deg; "
            f"needed is zone {own} or at most {MAX_ZONES_APART} from it"
        )
    return utm_code(crs)
