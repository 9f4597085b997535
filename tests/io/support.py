"""What the tests of the readers share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from laci_stereo.core.errors import LaciError
from laci_stereo.core.world import World

T = TypeVar("T")

SHARED = Path(__file__).parents[2] / "../shared"

needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="the shared data sets are not beside the project")

# Each example overwrites the same files, so one folder does for all of them.
fuzz = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def read_or_refused(read: Callable[[], T], refusal: type[LaciError]) -> T | None:
    """Return what is read, or None if it is refused as it should be: with this exception, in one line."""
    try:
        return read()
    except refusal as error:
        message = str(error)
    assert message.strip()
    assert len(message.splitlines()) == 1
    return None


# Arbitrary bytes seldom get past the first check of a parser, so pieces of its language are mixed in.
def noise(*pieces: str) -> st.SearchStrategy[bytes]:
    words = st.one_of(st.sampled_from(pieces), st.text(max_size=8)) if pieces else st.text(max_size=8)
    texts = st.lists(words, max_size=30).map(lambda found: "".join(found).encode("utf-8", "surrogatepass"))
    return st.one_of(texts, st.binary(max_size=200))


def mutations(whole: bytes) -> st.SearchStrategy[bytes]:
    """Return a whole file with a piece cut out and another one put in."""
    places = st.integers(0, len(whole))
    return st.builds(
        lambda a, b, piece: whole[: min(a, b)] + piece + whole[max(a, b) :], places, places, st.binary(max_size=12)
    )


def write_images(folder: Path, names: Sequence[str], size: tuple[int, int] = (8, 6)) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for i, name in enumerate(names):
        image = np.full((size[1], size[0]), i % 256, dtype=np.uint8)
        assert cv2.imwrite(str(folder / name), image)
    return folder


def with_utm(document: dict[str, Any]) -> dict[str, Any]:
    """Let the transform to UTM follow that to the world."""
    frame = document["world"]
    world = World(frame["crs"], tuple(frame["origin_utm"]), frame["grid_scale"])
    centre = np.array(document["covariance_centre_world"])
    document["T_utm_sensor"] = world.utm_from_sensor(np.array(document["T_world_sensor"]), centre).tolist()
    return document
