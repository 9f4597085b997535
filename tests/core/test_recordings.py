from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.core.drive_model import DriveModel
from laci_stereo.core.evidence import evidence_of
from laci_stereo.core.recordings import ALIKE, SENDERS_CLOCK_S, Recordings
from laci_stereo.core.settings import JointSettings
from tests.passages import passages

SIGMA_S = 0.01


def test_a_recording_has_one_clock_which_is_known_once() -> None:
    covariance = np.linalg.inv(Recordings([7, 8, 7]).clocks(np.full(3, SIGMA_S**-2)))
    assert np.diag(covariance) == pytest.approx(SIGMA_S**2, rel=0.01)
    assert covariance[0, 2] == pytest.approx(SIGMA_S**2, rel=0.01)
    assert covariance[0, 0] + covariance[2, 2] - 2 * covariance[0, 2] == pytest.approx(SENDERS_CLOCK_S**2, rel=0.01)
    assert covariance[1, [0, 2]] == pytest.approx(0.0)


def test_receivers_in_one_recording_err_alike_in_part_and_in_others_by_themselves() -> None:
    settings = JointSettings()
    models = [
        DriveModel(evidence_of(each.track, each.vehicle, each.ground.height_m), np.zeros(2), settings)
        for each in (passages()[0], passages()[0], passages()[1])
    ]
    count = len(models[0].knots_s)
    covariance = np.linalg.inv(Recordings([1, 1, 2]).drifts(models, settings))
    own, common, other = np.split(covariance[:count], [count, 2 * count], axis=1)
    assert own == pytest.approx(models[0].drift)
    assert common == pytest.approx(ALIKE * own)
    assert other == pytest.approx(0.0, abs=1e-12)
