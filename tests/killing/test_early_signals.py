# SPDX-License-Identifier: MIT
"""Signals while the command line is being imported end it quietly, with the status for them.

What comes before the handlers, in the first five file operations of `cli/`, is Python's.
"""

import os
import signal
from collections.abc import Sequence
from pathlib import Path

import pytest
from command_line import python

import salsanext_cli

SAID = {
    signal.SIGINT: "interrupted: everything finished so far is intact\n",
    signal.SIGTERM: "terminated: everything finished so far is intact\n",
}
PLACES = (Path(salsanext_cli.__file__).parents[1], Path(__file__).parent)
ENVIRONMENT = {"PYTHONPATH": os.pathsep.join(map(str, PLACES))}
COMMAND = "import sys; from salsanext_cli.__main__ import main; sys.argv.append('models'); main()"


@pytest.mark.parametrize(
    ("steps", "number"),
    [
        ((17,), signal.SIGTERM),
        *(pytest.param(range(6, 29, 2), number, marks=pytest.mark.slow) for number in SAID),
    ],
)
def test_a_signal_among_the_imports(steps: Sequence[int], number: signal.Signals) -> None:
    for step in steps:
        ended = python(COMMAND, SIGNAL_AT=f"salsanext_cli/cli/:{step}:{number:d}", **ENVIRONMENT)
        assert ended.stderr == (SAID[number] if ended.returncode else "")
        assert ended.returncode in (128 + number, 0 if step > 17 else None)


@pytest.mark.slow
def test_ctrl_c_before_there_are_handlers() -> None:
    ended = python(COMMAND, SIGNAL_AT=f"interruption.:1:{signal.SIGINT:d}", **ENVIRONMENT)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "")
