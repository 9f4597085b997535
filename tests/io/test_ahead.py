"""Working ahead: ordered, bounded, ended."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from laci_stereo.io.ahead import map_ahead, workers


def test_results_come_in_order_however_long_each_takes() -> None:
    def work(item: int) -> int:
        time.sleep(0.002 * (item % 3))
        return item * item

    assert list(map_ahead(work, range(40), 4)) == [item * item for item in range(40)]


@pytest.mark.parametrize("threads", [1, 3])
def test_it_looks_ahead_no_further_than_it_says(threads: int) -> None:
    drawn = 0

    def items() -> Iterator[int]:
        nonlocal drawn
        for item in range(100):
            drawn += 1
            yield item

    results = map_ahead(lambda item: item, items(), threads)
    assert drawn == 0
    for taken in range(1, 50):
        next(results)
        assert drawn <= taken + 2 * threads
    results.close()


def test_an_exception_reaches_the_consumer_after_what_came_before() -> None:
    def work(item: int) -> int:
        if item == 5:
            raise ValueError("five")
        return item

    seen: list[int] = []
    with pytest.raises(ValueError, match="five"):
        seen.extend(map_ahead(work, range(20), 2))
    assert seen == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("take", [1, 3])
def test_a_consumer_that_leaves_ends_the_threads(take: int) -> None:
    before = set(threading.enumerate())
    done = []
    results = map_ahead(done.append, range(1000), 3)
    for _ in range(take):
        next(results)
    results.close()
    assert set(threading.enumerate()) <= before
    assert len(done) <= take + 2 * 3


def test_nothing_gives_nothing() -> None:
    assert list(map_ahead(lambda item: item, [], 2)) == []


def test_workers_are_as_asked_or_as_there_are_processors() -> None:
    assert workers(3) == 3
    assert 1 <= workers(0) <= 8
