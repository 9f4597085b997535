from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.core.drive_model import DriveModel
from laci_stereo.core.evidence import evidence_of
from laci_stereo.core.recordings import ALIKE, SENDER_S, SENDER_SHARE, Recordings
from laci_stereo.core.settings import JointSettings
from tests.passages import passages


@pytest.mark.parametrize("sigma_s", [0.001, 0.01, 1.0])
def test_the_sensors_clock_is_common_to_a_recording_and_each_sender_stamps_by_itself(sigma_s: float) -> None:
    covariance = np.linalg.inv(Recordings([7, 8, 7]).clocks(np.full(3, sigma_s**-2)))
    own_s = min(SENDER_S, SENDER_SHARE * sigma_s)
    assert np.diag(covariance) == pytest.approx(sigma_s**2)
    assert covariance[0, 0] + covariance[2, 2] - 2 * covariance[0, 2] == pytest.approx(2 * own_s**2, rel=1e-3)
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
