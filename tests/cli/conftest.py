# SPDX-License-Identifier: MIT
"""A command line in this process, and a data set for it."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from command_line import called
from narrow import narrow, once_predicted, predicted, weights  # noqa: F401
from scans import write_sequence
from typer.testing import Result

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
