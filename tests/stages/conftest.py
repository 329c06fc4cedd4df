# SPDX-License-Identifier: MIT
"""Fixtures shared by the tests of stages."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from scans import SMALL, lively, write_weights
from world import Kept, World

from salsanext_cli import label_space
from salsanext_cli.network import salsanext
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.network.designs import SALSANEXT
from salsanext_cli.network.rangenet53 import RangeNet53
from salsanext_cli.network.registry import ARCHITECTURES
from salsanext_cli.network.salsanext import SalsaNext
from salsanext_cli.network.weights import save_weights

NARROW = replace(SALSANEXT, widths=(8, 16, 32, 32, 32), decoder_widths=(32, 32, 16, 16))
"""Few channels: the stages are tested here, and a network of full size takes most of the time."""


@contextmanager
def narrow_salsanext() -> Iterator[None]:
    """Have few channels in the network that is called salsanext, in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(salsanext, "CONTEXT_WIDTH", 8)
        patch.setitem(ARCHITECTURES, "salsanext", partial(SalsaNext, design=NARROW))
        yield


@pytest.fixture(autouse=True, scope="module")
def narrow() -> Iterator[None]:
    with narrow_salsanext():
        yield


@pytest.fixture(scope="session")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with narrow_salsanext():
        return write_weights(tmp_path_factory.mktemp("narrow") / "random.safetensors")


@pytest.fixture(scope="session")
def once_predicted(tmp_path_factory: pytest.TempPathFactory, weights: Path) -> Kept:
    with narrow_salsanext():
        return Kept(tmp_path_factory.mktemp("predicted"), weights, World.predict)


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
