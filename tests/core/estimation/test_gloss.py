from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.estimation import gloss
from laci_stereo.core.estimation.drive_model import DriveModel
from laci_stereo.core.estimation.drive_prior import GLOSS
from laci_stereo.core.estimation.drive_rows import FIRST_OWN
from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.estimation.joint import fit_jointly
from laci_stereo.core.frames import FloatArray
from tests.core.estimation.test_joint import at_the_truth, error
from tests.core.outlines import TRUTH, evidence, with_borders
from tests.simulated import Drive

_BEGIN = TRUTH(np.array([[65.0, 6.0]]))[0]
COMING = Drive((_BEGIN[0], _BEGIN[1]), np.degrees(TRUTH.yaw_rad) + 180.0, speeds=((0.0, 7.0),))
"""From 65 m away, 6 m beside the sensor, it comes to 25 m away: its side is grazed."""


def expected(drive: Evidence) -> tuple[DriveModel, FloatArray]:
    """Return the model of a drive, and the parameters of what is expected of any vehicle, where it is."""
    model, x = at_the_truth(drive)
    x[FIRST_OWN:] = model.prior.mean
    return model, x


def share_of(paint: float, cos: FloatArray) -> FloatArray:
    """Return how much of what a matcher sees is mirrored by a paint that scatters such a share of the light."""
    light = gloss.MIRRORED + (1.0 - gloss.MIRRORED) * (1.0 - cos) ** 5
    share: FloatArray = light**2 / (light**2 + ((1.0 - light) * paint) ** 2)
    return share


def glossy(drive: Evidence, by: float, paint: float | None = None) -> Evidence:
    """Return a drive whose points are too far by so many standard deviations where all is mirrored.

    Of a paint that scatters such a share, or as all paints do on average.
    """
    model, x = expected(drive)
    lines = model._sight_lines(x, model._poses(x), np.arange(len(drive.points)))
    sensor = np.array([0.0, 0.0, drive.height_m])
    sight = drive.points - sensor
    level_m = np.hypot(*sight[:, :2].T)
    cos = lines.hits.cos * level_m / np.linalg.norm(sight, axis=1)
    share = gloss.mirrored(cos)[:, 0] if paint is None else share_of(paint, cos)
    deeper = by * share * drive.sigma_along_m * (lines.hits.cos > 0.0)
    return replace(drive, points=sensor + sight * (1.0 + deeper / level_m)[:, None])


def seen(seed: int, by: float, paint: float | None = None) -> Evidence:
    plain = replace(evidence(COMING, seed=seed, sigma_m=0.3, per_frame=60), window_rad=0.01)
    return with_borders(glossy(plain, by, paint), COMING, sigma=0.2, seed=seed)


def test_what_is_mirrored_grows_from_nearly_nothing_to_nearly_all_as_a_side_is_grazed() -> None:
    cos = np.linspace(0.0, 1.0, 101)
    share = gloss.mirrored(cos)[:, 0]
    assert (np.diff(share) < 0.0).all()
    # The mean over all paints, from black to white.
    paints = np.geomspace(*gloss.SCATTERED, 10_001)
    for at, each in ((1.0, share[-1]), (0.0, share[0])):
        assert each == pytest.approx(share_of(paints, np.full(len(paints), at)).mean(), rel=1e-3)


def test_what_is_mirrored_is_about_what_fresnels_equations_have() -> None:
    """Clear coat has a refractive index of 1.5; Schlick's formula is some hundredths off in between."""
    cos, index = np.linspace(0.0, 1.0, 101), 1.5
    inside = np.sqrt(1.0 - (1.0 - cos**2) / index**2)
    across, along = (cos - index * inside) / (cos + index * inside), (inside - index * cos) / (inside + index * cos)
    light = (across**2 + along**2) / 2
    paints = np.geomspace(*gloss.SCATTERED, 1001)[:, None]
    share = (light**2 / (light**2 + ((1.0 - light) * paints) ** 2)).mean(axis=0)
    off = np.abs(gloss.mirrored(cos)[:, 0] - share)
    assert off.max() < 0.08
    assert off[[0, -1]].max() < 0.001


def test_what_any_paint_mirrors_is_the_mean_and_its_own_share_of_one_difference() -> None:
    cos = np.linspace(0.0, 1.0, 101)
    mean, darker = gloss.mirrored(cos).T
    apart = np.array([share_of(paint, cos) - mean for paint in np.geomspace(*gloss.SCATTERED, 201)])
    shares = apart @ darker / (darker @ darker)
    assert np.sqrt(np.mean(shares**2)) == pytest.approx(1.0, rel=0.02)
    black, white = shares[0], shares[-1]
    assert black > 1.0
    assert white < -1.0
    left = apart - shares[:, None] * darker
    assert np.square(left).mean() < 0.1 * np.square(apart).mean()


@pytest.mark.parametrize("by", [*(pytest.param(by, marks=pytest.mark.slow) for by in (0.0, 8.0)), 4.0])
def test_a_side_that_mirrors_turns_the_result_by_no_more_than_is_claimed(by: float) -> None:
    squared = []
    for seed in range(4):
        fit = fit_jointly([seen(seed, by)], TRUTH, close=True)
        squared.append(error(fit)[0] ** 2 / fit.covariance[0, 0])
    # What may last from frame to frame is in the doubt and not in these points, so that the error is a part of it.
    assert np.mean(squared) < 1.0


@pytest.mark.slow
def test_any_paint_turns_and_shifts_the_result_by_no_more_than_is_claimed() -> None:
    rng = np.random.default_rng(0)
    squared = []
    for seed in range(12):
        by, paint = rng.exponential(gloss.SHIFT), np.exp(rng.uniform(*np.log(gloss.SCATTERED)))
        fit = fit_jointly([seen(seed, by, paint)], TRUTH, close=True)
        off = np.array(error(fit))
        squared.append(off @ np.linalg.solve(fit.covariance, off) / 3.0)
        assert not fit.optics
    assert np.mean(squared) < 1.0


def test_what_is_as_glossy_as_it_is_taken_for_lies_where_it_is() -> None:
    plain = replace(evidence(COMING, sigma_m=0.3, per_frame=60), window_rad=0.01)
    distances = []
    for drive, by in ((plain, 0.0), (glossy(plain, 4.0), 4.0), (glossy(plain, 4.0), 0.0)):
        model, x = expected(drive)
        x[FIRST_OWN:][GLOSS] = by, 0.0
        distances.append(model.rows(x).distance)
    matt, undone, mirroring = distances
    assert len(matt) == len(undone) == len(mirroring)
    assert np.median(np.abs(undone - matt)) < 1e-9
    assert np.median(matt - mirroring) > 0.01


@pytest.mark.slow
def test_the_less_is_known_of_gloss_the_less_a_grazed_side_tells(monkeypatch: pytest.MonkeyPatch) -> None:
    shift, sigma = np.array(gloss.EXPECTED), np.array(gloss.SIGMA)
    doubts = []
    for share in (0.005, 1.0):
        monkeypatch.setattr(gloss, "EXPECTED", share * shift)
        monkeypatch.setattr(gloss, "SIGMA", share * sigma)
        doubts.append(np.sqrt(fit_jointly([seen(0, 0.0)], TRUTH, close=True).covariance[0, 0]))
    matt, unknown = doubts
    assert unknown > 1.02 * matt


def test_a_scanner_sees_no_gloss() -> None:
    model, x = expected(evidence(COMING))
    rows = model.rows(x)
    assert (rows.jacobian[:, FIRST_OWN:][:, GLOSS] == 0.0).all()
