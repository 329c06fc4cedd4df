# SPDX-License-Identifier: MIT
"""Plug-in of pytest that skips the tests for which no time is left.

`gpu_run` loads it, with the time by `time.monotonic` in `TESTS_END`.
"""

import os
import time

import pytest

END = "TESTS_END"


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Skip a test after the end."""
    if time.monotonic() > float(os.environ[END]):
        pytest.skip("no time is left")
