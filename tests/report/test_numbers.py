# SPDX-License-Identifier: MIT
import math

import pytest

from salsanext_cli.report.numbers import percent


@pytest.mark.parametrize(
    ("share", "digits", "unit", "words"),
    [
        (0.12345, 1, "", "12.3"),
        (0.12345, 2, " %", "12.35 %"),
        (0, 1, " %", "0.0 %"),
        (math.nan, 2, " %", "–"),
    ],
)
def test_shares_read_as_percent(share, digits, unit, words):
    assert percent(share, digits, unit) == words
