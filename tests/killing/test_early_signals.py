# SPDX-License-Identifier: MIT
"""Signals while the command line is being imported end it quietly, with the status for them.

What comes before the first module of the package is Python's.
"""

import os
import random
import signal
import subprocess
import sys
import time
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


@pytest.mark.parametrize(
    ("step", "number"),
    [(17, signal.SIGTERM), pytest.param(1, signal.SIGINT, marks=pytest.mark.slow)],
)
def test_a_signal_among_the_imports(step: int, number: signal.Signals) -> None:
    process = begun(SIGNAL_AT=f"salsanext_cli/cli/:{step}:{number:d}")
    assert process.communicate(timeout=60) == ("", SAID[number])
    assert process.returncode == 128 + number


@pytest.mark.slow
def test_ctrl_c_before_there_are_handlers() -> None:
    process = begun(SIGNAL_AT=f"interruption.:1:{signal.SIGINT:d}")
    assert process.communicate(timeout=60) == ("", "")
    assert process.returncode == 130


@pytest.mark.slow
@SIGNALS
def test_signals_at_many_moments(number: signal.Signals) -> None:
    draw = random.Random(int(number))
    found = set()
    for _ in range(40):
        process = begun()
        time.sleep(draw.uniform(0.02, 1.5))
        process.send_signal(number)
        _, said = process.communicate(timeout=60)
        found.add(process.returncode)
        if process.returncode == 128 + number:
            assert said in (SAID[number], "")
        elif process.returncode == -number:
            # Before the first module of the package, or after the last.
            assert "salsanext_cli/cli" not in said
        else:
            assert (process.returncode, said) == (0, "")
    assert 128 + number in found
