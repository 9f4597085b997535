"""The pose of a sensor in the grid, and the description that accompanies it in every file of another tool."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.world import World

STATEMENT = "laci_calibration"
"""Name under which every exported file states in JSON what its numbers alone do not."""

_STATEMENT = re.compile(rf'"?{STATEMENT}"?\s*:\s*(?=\{{)')


@dataclass(frozen=True)
class Siting:
    """The pose of a sensor, with everything that exports state about it.

    Attributes
    ----------
    name, kind, frame : str
        Of the sensor; the frame is described in words.
    world : World
    T_world_sensor : ndarray, shape (4, 4)
    centre_world : ndarray, shape (3,)
        The point at which a rigid transform into the grid is true to scale.
    """

    name: str
    kind: str
    frame: str
    world: World
    T_world_sensor: FloatArray
    centre_world: FloatArray

    @property
    def T_map_sensor(self) -> FloatArray:
        """Transform to grid metres from the world's origin, shape (4, 4): rigid, exact in the plane at the centre."""
        return self.world.grid_from_sensor(self.T_world_sensor, self.centre_world)

    @property
    def T_utm_sensor(self) -> FloatArray:
        """Transform to UTM coordinates, shape (4, 4): `T_map_sensor`, shifted by the world's origin."""
        return self.world.utm_from_sensor(self.T_world_sensor, self.centre_world)


def rigid_in_grid(world: World, T_map_sensor: FloatArray, centre_world: FloatArray) -> FloatArray:
    """Return ``T_world_sensor``, shape (4, 4), from ``T_map_sensor``: the inverse of `World.grid_from_sensor`."""
    T: FloatArray = T_map_sensor.copy()
    T[:2, 3] -= (world.grid_scale - 1.0) * centre_world[:2]
    return T


def words(siting: Siting, *, absolute: bool) -> tuple[str, ...]:
    """Describe an exported transform's frames in lines: to UTM itself if ``absolute``, else to the map frame."""
    (east, north), crs, scale = siting.world.origin_utm, siting.world.crs, siting.world.grid_scale
    centre = siting.world.to_utm(siting.centre_world[None, :2])[0]
    target = (
        f"utm: x = UTM east, y = UTM north ({crs}), z = height over the ground, metres; beyond what float32 can hold"
        if absolute
        else f"map: x = grid east, y = grid north, z = height over the ground, metres; UTM of {crs} is "
        f"x + {east:.0f}, y + {north:.0f}"
    )
    name = "utm" if absolute else "map"
    off_cm = 100.0 * 100.0 * abs(scale - 1.0)
    exact_at = f"UTM {centre[0]:.1f}, {centre[1]:.1f}, the middle of what it was made from"
    return (
        _on_one_line(f"sensor: {siting.name} ({siting.kind}), {siting.frame}; metres"),
        target,
        f"direction: sensor to {name}, p_{name} = T_{name}_sensor p_sensor",
        f"scale: rigid, and exact at {exact_at}; by the grid's scale, {scale:.7f}, {off_cm:.1f} cm off at 100 m",
    )


def _on_one_line(text: str) -> str:
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())


def statement(siting: Siting) -> dict[str, Any]:
    """Return the JSON object from which an exported transform can be imported without loss."""
    return {
        "name": siting.name,
        "kind": siting.kind,
        "frame": siting.frame,
        "crs": siting.world.crs,
        "origin_utm": list(siting.world.origin_utm),
        "grid_scale": siting.world.grid_scale,
        "centre_world": siting.centre_world.tolist(),
    }


def comments(siting: Siting, *, absolute: bool = False) -> str:
    """Return `words` and `statement` as comment lines that begin with ``#``."""
    told = f"{STATEMENT}: {json.dumps(statement(siting))}"
    return "".join(f"# {line}\n" for line in (*words(siting, absolute=absolute), told))


@dataclass(frozen=True)
class Statement:
    """The statement of an exported file about itself, see `statement`."""

    name: str
    kind: str
    frame: str
    world: World
    centre_world: FloatArray


def find_statement(text: str) -> Statement | None:
    """Return an exported file's statement about itself, or None if it has none or an invalid one."""
    found = _STATEMENT.search(text)
    if found is None:
        return None
    try:
        fields, _ = json.JSONDecoder().raw_decode(text, found.end())
        east, north = (float(value) for value in fields["origin_utm"])
        world = World(str(fields["crs"]), (east, north), float(fields["grid_scale"]))
        centre = np.array(fields["centre_world"], dtype=np.float64).reshape(3)
        found_statement = Statement(str(fields["name"]), str(fields["kind"]), str(fields["frame"]), world, centre)
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
        return None
    sound = np.abs([east, north, *centre]).max() < 1e8 and 0.9 < world.grid_scale < 1.1  # False for NaN, too
    return found_statement if sound else None
