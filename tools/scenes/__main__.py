"""Write the data set of a random scene.

usage: python -m tools.scenes --seed 7 --sensor lidar_32 --out DIR [--set drive=left_turn --set receiver=exact ...]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from tools.scenes.scene import SENSORS, draw_scene
from tools.scenes.write import write_scene


def settings(texts: list[str]) -> dict[str, object]:
    """Parse factors such as ``height_m=6`` or ``drive=left_turn``."""
    found: dict[str, object] = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            found[name] = json.loads(value)
        except json.JSONDecodeError:
            found[name] = {"True": True, "False": False, "None": None}.get(value, value)
    return found


def main() -> None:
    """Draw a scene and write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sensor", choices=SENSORS, default="lidar_32")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--set", action="append", default=[], metavar="FACTOR=VALUE", help="see tools/scenes/scene.py")
    arguments = parser.parse_args()
    scene = draw_scene(arguments.seed, arguments.sensor, **settings(arguments.set))
    write_scene(scene, arguments.out)
    height = scene.T_world_sensor[2, 3]
    print(
        f"{arguments.out}: {len(scene.times_s)} frames, {len(scene.messages)} messages, {scene.vehicle.kind} at "
        f"{scene.place.name}, sensor {height:.2f} m high, in view for {scene.seen} frames"
    )


if __name__ == "__main__":
    main()
