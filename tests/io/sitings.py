"""Sensors at known places, for what is written about them for other tools."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from laci_stereo.core.frames import FloatArray, rigid
from laci_stereo.core.world import World
from laci_stereo.io.result.siting import Siting

ULM = World.around(48.4226, 9.9434)
CAPE_TOWN = World.around(-33.918, 18.423)
FIJI = World.around(-17.8, -179.9)  # near the other end of the northings, at the edge of the last zone
CONTINUED = World.around(48.4226, 9.9434, "EPSG:32631")  # a grid that goes on into the zone beside its own


def siting(
    kind: str = "stereo", world: World = ULM, yaw_deg: float = 114.7, down_deg: float = 15.0, name: str = "mast 3"
) -> Siting:
    """Return a sensor 6.5 m high, 25 m from the middle of its track."""
    level = Rotation.from_euler("ZYX", [yaw_deg, down_deg, 0.8], degrees=True).as_matrix()
    # A camera's right, down and forward are the level frame's -y, -z and x.
    camera = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    rotation = level @ camera if kind == "stereo" else level
    T_world_sensor = rigid(rotation, np.array([8.6, -23.8, 6.5]))
    return Siting(name, kind, "as it is: x, y, z", world, T_world_sensor, np.array([-4.3, 4.5, 0.0]))


SITINGS = [
    siting("stereo", ULM),
    siting("lidar", CAPE_TOWN, yaw_deg=-71.0, down_deg=3.0),
    siting("detections", FIJI, yaw_deg=5.0, down_deg=0.0, name='the "odd" one: #1\nwith --x 5'),
    siting("lidar", ULM, yaw_deg=30.0, down_deg=90.0, name="looks straight down"),
]


def ten_points() -> FloatArray:
    """Return points, shape (10, 3), up to 60 m from a sensor."""
    return np.random.default_rng(4).uniform(-60.0, 60.0, (10, 3))


def sitings() -> st.SearchStrategy[Siting]:
    return st.builds(
        siting,
        st.sampled_from(["stereo", "lidar", "detections"]),
        st.sampled_from([ULM, CAPE_TOWN, FIJI]),
        st.floats(-180, 180),
        st.floats(-40, 80),  # down: what looks farther up is refused
        st.text(max_size=12),
    )
