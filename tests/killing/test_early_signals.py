# SPDX-License-Identifier: MIT
"""Signals while the command line is being imported end it quietly, with the status for them.

What comes before the first module of the package is Python's.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

import salsanext_cli

SIGNALS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
SAID = {
    signal.SIGINT: "interrupted: everything finished so far is intact\n",
    signal.SIGTERM: "terminated: everything finished so far is intact\n",
}


def begun(**environment: str) -> subprocess.Popen[str]:
    """Start what the console script starts."""
    places = (Path(salsanext_cli.__file__).parents[1], Path(__file__).parent)
    return subprocess.Popen(
        [sys.executable, "-c", "from salsanext_cli.__main__ import main; main()", "models"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, places)), **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize("steps", [(17,), pytest.param(range(1, 26, 2), marks=pytest.mark.slow)])
@SIGNALS
def test_a_signal_among_the_imports(steps: Sequence[int], number: signal.Signals) -> None:
    for step in steps:
        process = begun(SIGNAL_AT=f"salsanext_cli/cli/:{step}:{number:d}")
        said = process.communicate(timeout=60)
        assert said[1] == (SAID[number] if process.returncode else "")
        assert process.returncode in (128 + number, 0 if step > 17 else None)


@pytest.mark.slow
def test_ctrl_c_before_there_are_handlers() -> None:
    process = begun(SIGNAL_AT=f"interruption.:1:{signal.SIGINT:d}")
    assert process.communicate(timeout=60) == ("", "")
    assert process.returncode == 130
