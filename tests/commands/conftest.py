# SPDX-License-Identifier: MIT
"""Fixtures of stages and of the command line: a data set, and commands in this process."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from command_line import called
from narrow_network import narrow, once_predicted, predicted, weights  # noqa: F401
from scans import add_housing, write_sequence
from typer.testing import Result
from world import World

ALONE = ("SALSANEXT_OUT", "SALSANEXT_DATASET")
Run = Callable[..., Result]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Run:
    """Return a function that runs a command, with any status unless it is given."""
    for name in ALONE:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("SALSANEXT_ENGINE", "torch")  # Compiling graphs takes longer.
    return partial(called, status=None)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Return a data set of one sequence of the split "valid"."""
    write_sequence(tmp_path / "data/sequences/08", ["000000", "000001"])
    return tmp_path / "data"


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
def in_few_steps(one_step_fits: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fit a useless error model, and accept it."""
    from salsanext_cli.training.tuning import error

    monkeypatch.setattr(error, "gains", lambda model: True)


@pytest.fixture(autouse=True)
def undrawn_unless_marked(request: pytest.FixtureRequest) -> None:
    """Draw no plots of results and no pixels of figures, unless a test is `drawn`."""
    if not request.node.get_closest_marker("drawn"):
        request.getfixturevalue("undrawn")
