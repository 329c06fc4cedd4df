# SPDX-License-Identifier: MIT
"""A signal at a step of a run; Python imports this first if PYTHONPATH names the folder.

``SIGNAL_AT=FOLDER:STEP:SIGNAL`` sends a signal to the process itself before it opens, renames,
removes or makes something below the folder for the so-manieth time, from 1.
"""

import os
import sys
from collections.abc import Callable

STEPS = ("open", "os.rename", "os.remove", "os.mkdir")
"""What a process does to files, as Python's audit names it."""


def at_each_step(folder: str, call: Callable[[int], object]) -> None:
    """Call something with the number of each step of this process, before it is done."""
    steps = 0

    def count(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal steps
        if event in STEPS and folder in str(arguments[0]):
            steps += 1
            call(steps)

    sys.addaudithook(count)


def signal_at(folder: str, step: int, number: int) -> None:
    """Send a signal to this process before a step."""
    at_each_step(folder, lambda steps: steps == step and os.kill(os.getpid(), number))


if "SIGNAL_AT" in os.environ:
    _folder, _step, _number = os.environ["SIGNAL_AT"].split(":")
    signal_at(_folder, int(_step), int(_number))
