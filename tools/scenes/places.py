"""Places on Earth for scenes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pyproj import Geod, Proj

from laci_stereo.core.frames import FloatArray, rigid, rotate_xy, rotation_z

GEOD = Geod(ellps="WGS84")


@dataclass(frozen=True)
class Place:
    """A scene's frame on the map: UTM = origin + ``scale`` * (xy of the scene, rotated by ``yaw_rad``).

    Attributes
    ----------
    name : str
    latitude_deg, longitude_deg : float
        Position of the origin.
    epsg : int
        EPSG code of the UTM zone.
    yaw_rad : float
        Direction of the scene's x axis, counter-clockwise from grid east.
    """

    name: str
    latitude_deg: float
    longitude_deg: float
    epsg: int
    yaw_rad: float = 0.0

    @cached_property
    def proj(self) -> Proj:
        """The projection."""
        return Proj(f"EPSG:{self.epsg}")

    @cached_property
    def origin_utm(self) -> FloatArray:
        """East and north of the origin, metres, shape (2,)."""
        return np.array(self.proj(self.longitude_deg, self.latitude_deg))

    @cached_property
    def scale(self) -> float:
        """Grid metres per true metre, from two geodesics of 100 m, one to the east and one to the north."""
        utm = self.origin_utm + np.array([[-50.0, 0.0], [50.0, 0.0], [0.0, -50.0], [0.0, 50.0]])
        east, north = utm.T.tolist()
        lon, lat = (np.array(values) for values in self.proj(east, north, inverse=True))
        metres = GEOD.inv(lon[::2].tolist(), lat[::2].tolist(), lon[1::2].tolist(), lat[1::2].tolist())[2]
        return 200.0 / float(sum(metres))

    def to_utm(self, xy: FloatArray) -> FloatArray:
        """Map the scene's xy, shape (n, 2), to east and north."""
        utm: FloatArray = self.origin_utm + self.scale * rotate_xy(self.yaw_rad, xy)
        return utm

    def geodetic(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return latitude and longitude in degrees of the scene's xy, shape (n, 2)."""
        east, north = self.to_utm(xy).T.tolist()
        longitude, latitude = self.proj(east, north, inverse=True)
        return np.array(latitude), np.array(longitude)

    def heading_deg(self, xy: FloatArray, yaw_rad: FloatArray) -> FloatArray:
        """Return the azimuth of a step of 10 m along yaw in the scene, clockwise from true north, shape (n,)."""
        step = 5.0 * np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
        (lat0, lon0), (lat1, lon1) = self.geodetic(xy - step), self.geodetic(xy + step)
        azimuth = GEOD.inv(lon0.tolist(), lat0.tolist(), lon1.tolist(), lat1.tolist())[0]
        heading: FloatArray = np.array(azimuth) % 360.0
        return heading

    def T_utm_scene(self, about_xy: FloatArray) -> FloatArray:
        """Return the rigid transform, shape (4, 4), into UTM that is exact at a point of the scene, shape (2,)."""
        rotation = rotation_z(self.yaw_rad)
        shift = self.to_utm(about_xy[None])[0] - rotation[:2, :2] @ about_xy
        return rigid(rotation, np.append(shift, 0.0))


PLACES = (
    Place("Ulm", 48.42, 9.94, 32632),
    Place("Sydney", -33.86, 151.2, 32756),
    Place("zone border", 52.0, 12.0, 32633),
    Place("equator", 0.0, -78.5, 32617),
    Place("south of the equator", -0.3, -78.5, 32717),
    Place("Tromso", 69.65, 18.95, 32634),
    Place("Longyearbyen", 78.22, 15.63, 32633),
    Place("Ushuaia", -54.8, -68.3, 32719),
    Place("date line", -16.8, 179.97, 32760),
)
"""Both hemispheres, zone borders, high latitudes."""
