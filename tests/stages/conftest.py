# SPDX-License-Identifier: MIT
"""Fixtures shared by the tests of stages."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from narrow import narrow, once_predicted, predicted, weights  # noqa: F401
from scans import SMALL, lively
from world import World

from salsanext_cli import label_space
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.network.rangenet53 import RangeNet53
from salsanext_cli.network.registry import ARCHITECTURES
from salsanext_cli.network.weights import save_weights


@pytest.fixture
def target(tmp_path: Path) -> Path:
    """Return the name of weights to write."""
    return tmp_path / "tuned.safetensors"


@pytest.fixture
def on_openvino(world: World) -> World:
    """Return the world with the engine that users have; torch starts sooner."""
    return replace(world, network=replace(world.network, engine="openvino"))


@pytest.fixture
def narrow_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return weights of a random network with many batch norms and few channels."""
    monkeypatch.setitem(ARCHITECTURES, "narrow", partial(RangeNet53, width=2))
    architecture = {"name": "narrow", "class_count": 20, "dropout": 0.1}
    card = WeightsCard(architecture, label_space(), SMALL, description="random")
    save_weights(tmp_path / "random.safetensors", lively(RangeNet53(width=2)), card)
    return tmp_path / "random.safetensors"
