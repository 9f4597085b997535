"""Work in threads ahead of its consumer: ordered, limited in number, and cancelled when the consumer stops."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def workers(asked: int) -> int:
    """Return the number of threads to use: as asked or, for 0 or less, one per processor, at most 8."""
    return asked if asked > 0 else min(os.cpu_count() or 1, 8)


def map_ahead(work: Callable[[Item], Result], items: Iterable[Item], threads: int) -> Iterator[Result]:
    """Yield ``work(item)`` in order, while the next ``2 * threads`` items are processed.

    OpenCV and NumPy release the global interpreter lock in expensive operations, so threads suffice.
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
