"""Results of threads."""

from __future__ import annotations

import time

import pytest

from curlfit.numerics.threads import in_threads


def test_results_of_threads_come_in_order_and_errors_where_they_belong():
    with in_threads(lambda a, b: a - b, [(3, 1), (5, 4), (9, 2)]) as results:
        assert list(results) == [2, 1, 7]
    begun = []

    def inverse(number):
        begun.append(number)
        time.sleep(0.001)  # the other threads begin no more than a few
        return 1 / number

    with in_threads(inverse, [(1,), (0,)] * 50) as results:
        assert next(results) == 1.0
        with pytest.raises(ZeroDivisionError):
            next(results)
    assert len(begun) < 100
