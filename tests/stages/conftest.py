# SPDX-License-Identifier: MIT
"""Fixtures shared by the tests of stages."""

from pathlib import Path

import pytest


@pytest.fixture
def target(tmp_path: Path) -> Path:
    """Return the name of weights to write."""
    return tmp_path / "tuned.safetensors"
