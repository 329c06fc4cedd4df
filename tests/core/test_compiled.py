# SPDX-License-Identifier: MIT
"""Kernels: slices on threads."""

import threading
import time

import pytest
from devices import threads

from salsanext_cli.core.compiled import parallel_for


def test_an_error_of_any_thread_is_raised_after_all_are_done():
    together, arrived, done = threading.Barrier(3, timeout=10), iter(range(3)), []

    def work(_):
        together.wait()
        if next(arrived) == 1:
            raise ValueError("no")
        time.sleep(0.05)
        done.append(1)

    with threads(3), pytest.raises(ValueError, match="no"):
        parallel_for(work, range(3))
    assert len(done) == 2
