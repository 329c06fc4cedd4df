# SPDX-License-Identifier: MIT
"""Names of all architectures for tests of each; those that add minutes only to the slow ones."""

import pytest

from salsanext_cli.network.registry import ARCHITECTURES

FAST = ("salsanet", "salsanext", "salsanext-v1")
EACH = [
    pytest.param(name, marks=() if name in FAST else pytest.mark.slow)
    for name in sorted(ARCHITECTURES)
]
