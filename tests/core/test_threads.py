from __future__ import annotations

from contextlib import nullcontext

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from laci_stereo.core.threads import in_one_thread


def blas_threads() -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


@pytest.mark.parametrize("fails", [False, True])
def test_linear_algebra_takes_one_thread_and_as_many_as_before_afterwards(fails: bool) -> None:
    seen = []

    @in_one_thread
    def work() -> None:
        seen.append(blas_threads())
        if fails:
            raise ZeroDivisionError

    with threadpool_limits(2, user_api="blas"):
        if blas_threads() != {2}:
            pytest.skip("this NumPy's linear algebra has threads that nobody can set")
        with pytest.raises(ZeroDivisionError) if fails else nullcontext():
            work()
        assert blas_threads() == {2}
    assert seen == [{1}]
