from __future__ import annotations

from laci_stereo.core.subsampling import evenly, spread


def test_spread_takes_the_ends_and_no_more_than_asked() -> None:
    few = spread(range(100), 5)
    assert len(few) == 5
    assert (few[0], few[-1]) == (0, 99)
    assert spread(range(3), 31) == [0, 1, 2]
    assert spread((), 31) == []


def test_steps_between_what_is_taken_differ_by_one_at_most() -> None:
    for count in range(1, 60):
        steps = set((evenly(count, 17)[1:] - evenly(count, 17)[:-1]).tolist())
        assert len(steps) <= 2
        assert not steps or max(steps) - min(steps) <= 1
