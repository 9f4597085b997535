from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module

import pytest

from laci_stereo.core.cloud import PointCloudSource
from laci_stereo.core.observe import Observation, observe
from laci_stereo.core.settings import JointSettings, MatchSettings, QualitySettings, Settings


@pytest.fixture(scope="module")
def observed_once() -> Iterator[None]:
    """What a sensor saw is worked out once for all calibrations of a recording that differ in what follows."""
    # With the recording itself, so that no other one takes its number.
    kept: dict[tuple[int, Settings], tuple[PointCloudSource, Observation]] = {}

    def once(source: PointCloudSource, settings: Settings, *_: object) -> Observation:
        own = replace(settings, method="joint", match=MatchSettings(), joint=JointSettings(), quality=QualitySettings())
        key = (id(source), own)
        if key not in kept:
            kept[key] = source, observe(source, own)
        return kept[key][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_module("laci_stereo.core.calibrate"), "observe", once)
        yield
