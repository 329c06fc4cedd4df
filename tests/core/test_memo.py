# SPDX-License-Identifier: MIT
"""Memory of the last results of a slow function."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from salsanext_cli.core.memo import Memo


def test_a_result_is_computed_once_while_it_is_among_the_last():
    memo: Memo[int] = Memo(2)
    computed = []

    def square(number: int) -> int:
        return memo.result(number, lambda: computed.append(number) or number**2)

    assert [square(number) for number in (1, 2, 1, 3, 1, 2)] == [1, 4, 1, 9, 1, 4]
    # The third key took the place of 2, which was asked for longest ago.
    assert computed == [1, 2, 3, 2]


def test_none_is_a_result_and_an_error_is_not():
    memo: Memo[None] = Memo(2)
    assert memo.result("a", lambda: None) is None
    assert memo.result("a", lambda: pytest.fail("computed twice")) is None

    def fail() -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        memo.result("b", fail)
    assert memo.result("b", lambda: None) is None


def test_threads_get_the_results_of_their_keys():
    memo: Memo[int] = Memo(3)
    with ThreadPoolExecutor(8) as threads:
        results = threads.map(lambda n: memo.result(n % 5, lambda: 10 * (n % 5)), range(500))
        assert list(results) == [10 * (n % 5) for n in range(500)]
