# SPDX-License-Identifier: MIT
"""Fixtures shared by the tests of stages."""

from dataclasses import replace
from pathlib import Path

import pytest
from narrow import narrow, once_predicted, predicted, weights  # noqa: F401
from scans import add_housing
from world import World


@pytest.fixture
def target(tmp_path: Path) -> Path:
    """Return the name of weights to write."""
    return tmp_path / "tuned.safetensors"


@pytest.fixture
def housed(world: World) -> World:
    """Return the world; the first `HOUSING` points of each scan are on a housing."""
    add_housing(world.data)
    return world


@pytest.fixture
def on_openvino(world: World) -> World:
    """Return the world with the engine that users have; torch starts sooner."""
    return replace(world, network=replace(world.network, engine="openvino"))


@pytest.fixture
def in_few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fit a useless error model, and accept it."""
    from salsanext_cli.training.tuning import error

    monkeypatch.setattr(error, "MIN_STEPS", 1)
    monkeypatch.setattr(error, "gains", lambda model: True)
