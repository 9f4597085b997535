"""Check of a stereo calibration against image pairs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.check.rig_matches import Compared, PairMatches, Partners, match_pair, read_compared
from laci_stereo.check.rig_parallax import FEWEST_IN_CELL, lag, measure
from laci_stereo.check.rig_points import in_common, rectified
from laci_stereo.check.rig_verdict import Finding, Fit, Outcome, judge, outcome_of
from laci_stereo.core.errors import ImageError
from laci_stereo.core.subsampling import spread
from laci_stereo.io.images import StereoPair
from laci_stereo.io.rig.stereo_rig import Lens, Size, StereoRig
from laci_stereo.stereo.rectify import already_rectified

PAIRS = 5
"""Number of pairs that are compared, uniformly spaced: with some thousand matches, noise is far below systematic
errors."""


@dataclass(frozen=True)
class RigCheck:
    """Result of the check of a calibration against its images.

    Attributes
    ----------
    rig : StereoRig
        The calibration that was applied: scaled if the images are.
    size : tuple of int
        Size of the images, pixels.
    fit : Fit or None
        None if the images cannot come from these cameras.
    findings : tuple of Finding
    shown : Compared
        The pair for the picture.
    skipped : tuple of str
        The reason for each image that could not be read, one line each.
    """

    rig: StereoRig
    size: Size
    fit: Fit | None
    findings: tuple[Finding, ...]
    shown: Compared
    skipped: tuple[str, ...]

    @property
    def outcome(self) -> Outcome:
        """The verdict."""
        return outcome_of(self.findings)


@dataclass(frozen=True)
class Matched:
    """What image pairs show, independently of a calibration.

    Attributes
    ----------
    first : Compared
        The first pair that could be read.
    matches : tuple of PairMatches
    skipped : tuple of str
        The reason for each image that could not be read, one line each.
    """

    first: Compared
    matches: tuple[PairMatches, ...]
    skipped: tuple[str, ...]


def match_images(pairs: Sequence[StereoPair]) -> Matched:
    """Match points in some of the pairs, uniformly spaced.

    Raises
    ------
    ImageError
        If none of the selected pairs can be read.
    """
    images, skipped = _read(pairs)
    return Matched(images[0], tuple(match_pair(compared) for compared in images), skipped)


def check_rig(rig: StereoRig, matched: Matched) -> RigCheck:
    """Check a calibration against the matches of image pairs."""
    matches = matched.matches
    height, width = matched.first.left.shape
    size = (width, height)
    used, findings = _sized(rig, size)
    findings = (*findings, *_one_camera(matched.first))
    if used is None:
        return RigCheck(rig, size, None, findings, matched.first, matched.skipped)
    fit = fit_of(used, matches)
    against = judge(fit)
    if outcome_of(against) == "fail":
        swapped = tuple(swapped_images(used, matches))
        against = (*swapped, *against) if swapped else (*against, *flat_images(used, matches))
    elif used is not rig:
        findings = tuple(Finding("fail", f"{finding.text}; scaled to them it fits") for finding in findings)
    return RigCheck(used, size, fit, (*findings, *against), matched.first, matched.skipped)


def fit_of(rig: StereoRig, matches: Sequence[PairMatches]) -> Fit:
    """Evaluate matches under a calibration."""
    all_points = rectified(rig, matches)
    points, strange = in_common(all_points)
    strange += sum(not len(found) for found in matches)
    # Moving points may show a delay between the images, so they are not used to judge the calibration.
    still = points.chosen(~points.moves)
    judged = still if len(still) >= FEWEST_IN_CELL else points
    parallax = measure(judged) if len(judged) >= FEWEST_IN_CELL else None
    return Fit(
        points,
        len(matches),
        strange,
        parallax,
        # In images of different times, moving points do not satisfy the common epipolar geometry.
        None if parallax is None else lag(all_points.chosen(all_points.moves), parallax),
        _together([found.moving for found in matches]),
        _together([found.still for found in matches]),
    )


def _together(partners: Sequence[Partners]) -> Partners:
    return Partners(sum(each.points for each in partners), sum(each.matched for each in partners))


def _read(pairs: Sequence[StereoPair]) -> tuple[list[Compared], tuple[str, ...]]:
    """Read some pairs of equal size, uniformly spaced; return them and the reasons why others are left out."""
    images: list[Compared] = []
    skipped: list[str] = []
    for number in spread(range(len(pairs)), PAIRS):
        try:
            compared = read_compared(pairs, number)
        except ImageError as problem:
            skipped.append(str(problem))
            continue
        if images and compared.left.shape != images[0].left.shape:
            skipped.append(f"{pairs[number].left}: of another size than {pairs[0].left}; needed is one size")
        else:
            images.append(compared)
    if not images:
        raise ImageError(skipped[0])
    return images, tuple(skipped)


def _sized(rig: StereoRig, size: Size) -> tuple[StereoRig | None, tuple[Finding, ...]]:
    """Return the rig for images of a size, scaled if only the scale differs; None if they are of other cameras."""
    if rig.left.size == size:
        return rig, ()
    mismatch = "the images are {} x {} pixels, the calibration is for {} x {}".format(*size, *rig.left.size)
    if rig.rectified is not None and rig.rectified.left.size != rig.left.size:
        mismatch += ", rectified for {} x {}".format(*rig.rectified.left.size)
    factor = size[0] / rig.left.size[0]
    if abs(rig.left.size[1] * factor - size[1]) > 1:
        return None, (Finding("fail", f"{mismatch}: another camera's, or cropped"),)
    return scaled(rig, factor), (Finding("fail", f"{mismatch}: were they scaled by {factor:g}?"),)


def _one_camera(first: Compared) -> Iterator[Finding]:
    """Report if left and right are one image, which fits every calibration: with two cameras, noise differs."""
    if np.array_equal(first.left, first.right):
        yield Finding("fail", "left and right are the same images; needed are those of two cameras")


def scaled(rig: StereoRig, factor: float) -> StereoRig:
    """Return the rig for the same images resized by a factor."""

    def resized(lens: Lens) -> Lens:
        # The image border is half a pixel outside the centre of the first pixel.
        K = lens.K.copy()
        K[:2] *= factor
        K[:2, 2] += (factor - 1.0) / 2
        return replace(lens, K=K, size=(round(lens.size[0] * factor), round(lens.size[1] * factor)))

    return replace(rig, left=resized(rig.left), right=resized(rig.right), rectified=None)


def swapped_images(rig: StereoRig, matches: Sequence[PairMatches]) -> Iterator[Finding]:
    """Report swapped images if the calibration fits with left and right exchanged."""
    if _fits(rig, [found.swapped() for found in matches]):
        words = "the images of left and right are swapped, or all upside down, or T is given in the other direction"
        yield Finding("fail", f"{words}: the other way round the calibration fits")


def flat_images(rig: StereoRig, matches: Sequence[PairMatches]) -> Iterator[Finding]:
    """Report images that may be rectified already, if the calibration fits under this assumption."""
    flat = already_rectified(rig)
    if _fits(flat, matches):
        yield Finding("fail", "are the images rectified already? With --rectified the calibration fits")
    elif _fits(flat, [found.swapped() for found in matches]):
        yield Finding("fail", "are the images rectified already? With --rectified and left and right swapped it fits")


def _fits(rig: StereoRig, matches: Sequence[PairMatches]) -> bool:
    return outcome_of(judge(fit_of(rig, matches))) != "fail"
