from __future__ import annotations

import math

import pytest

from laci_stereo.core.association.words import odds, shares


@pytest.mark.parametrize(
    ("log_odds", "words"),
    [
        (0.0, "1.0 to 1"),
        (math.log(2.46), "2.5 to 1"),
        (math.log(9.96), "10 to 1"),
        (-math.log(66.5), "1 to 66"),
        (-math.log(122.5), "1 to 120"),
        (-100.0, "1 to 8100"),
        (100.0, "8100 to 1"),
    ],
)
def test_odds_have_two_significant_digits(log_odds: float, words: str) -> None:
    assert odds(log_odds) == words


@pytest.mark.parametrize(
    ("found", "needed", "words"),
    [
        (0.21, 0.5, ("21%", "50%")),
        (0.496, 0.5, ("49.6%", "50.0%")),
        (0.4996, 0.5, ("49.96%", "50.00%")),
        (0.49999, 0.5, ("50.00%", "50.00%")),
    ],
)
def test_a_share_below_its_limit_looks_like_it(found: float, needed: float, words: tuple[str, str]) -> None:
    assert shares(found, needed) == words
