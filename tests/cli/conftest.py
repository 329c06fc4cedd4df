# SPDX-License-Identifier: MIT
"""A command line in this process, and a data set for it."""

from collections.abc import Callable
from pathlib import Path

import pytest
from narrow import narrow, once_predicted, predicted, weights  # noqa: F401
from scans import write_sequence
from typer.testing import CliRunner, Result

from salsanext_cli.cli.app import app

ALONE = ("SALSANEXT_OUT", "SALSANEXT_DATASET")
Run = Callable[..., Result]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Run:
    """Return a function that runs a command, with stdout and stderr apart."""
    for name in ALONE:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("SALSANEXT_ENGINE", "torch")  # Compiling graphs takes longer.

    def call(*arguments: object) -> Result:
        return CliRunner().invoke(app, [str(argument) for argument in arguments])

    return call


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Return a data set of one sequence of the split "valid"."""
    write_sequence(tmp_path / "data/sequences/08", ["000000", "000001"])
    return tmp_path / "data"
