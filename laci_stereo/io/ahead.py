"""Work that runs ahead of who needs it: ordered, bounded, and ended with its consumer."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def workers(asked: int) -> int:
    """Return how many threads to use: as asked, or one for each processor, at most 8."""
    return asked if asked > 0 else min(os.cpu_count() or 1, 8)


def map_ahead(work: Callable[[Item], Result], items: Iterable[Item], threads: int) -> Iterator[Result]:
    """Yield ``work(item)`` in order, while the next ``2 * threads`` items are worked on.

    OpenCV and NumPy release the interpreter's lock in what is costly, so threads suffice.
    """
    pool = ThreadPoolExecutor(threads)
    pending: deque[Future[Result]] = deque()
    try:
        for item in items:
            pending.append(pool.submit(work, item))
            if len(pending) > 2 * threads:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
