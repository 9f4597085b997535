from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.core.drive_model import ALIKE
from laci_stereo.core.recordings import SENDER_S, SENDER_SHARE, Recordings
from laci_stereo.core.settings import JointSettings


@pytest.mark.parametrize("sigma_s", [0.001, 0.01, 1.0])
def test_the_sensors_clock_is_common_to_a_recording_and_each_sender_stamps_by_itself(sigma_s: float) -> None:
    covariance = np.linalg.inv(Recordings([7, 8, 7]).clocks(np.full(3, sigma_s**-2)))
    own_s = min(SENDER_S, SENDER_SHARE * sigma_s)
    assert np.diag(covariance) == pytest.approx(sigma_s**2)
    assert covariance[0, 0] + covariance[2, 2] - 2 * covariance[0, 2] == pytest.approx(2 * own_s**2, rel=1e-3)
    assert covariance[1, [0, 2]] == pytest.approx(0.0)


def test_receivers_err_alike_in_part_at_one_time_and_by_themselves_on_other_days() -> None:
    settings = JointSettings()
    knots_s = [np.array([0.0, 20.0]), np.array([20.0, 90.0]), np.array([20.0])]
    knots_m = [np.array([0.0, 30.0]), np.array([7.0, 7.0]), np.array([0.0])]
    covariance = np.linalg.inv(Recordings([1, 1, 2]).drifts(knots_s, knots_m, [0.01, 0.3, 0.02], settings))
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.01, 0.01, 0.3, 0.3, 0.02])
    assert covariance[1, 2] == pytest.approx(ALIKE * 0.01 * 0.3)
    driven = ALIKE + (1.0 - ALIKE) * np.exp(-30.0 / settings.bias_way_m)
    assert covariance[0, 1] == pytest.approx(0.01**2 * driven * np.exp(-20.0 / settings.bias_time_s))
    assert covariance[2, 3] == pytest.approx(0.3**2 * np.exp(-70.0 / settings.bias_time_s))
    assert covariance[0, 2] == pytest.approx(ALIKE * 0.01 * 0.3 * np.exp(-20.0 / settings.bias_time_s))
    assert covariance[4, :4] == pytest.approx(0.0)
