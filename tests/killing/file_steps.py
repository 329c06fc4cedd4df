# SPDX-License-Identifier: MIT
"""A signal at a step of a run; `sitecustomize` imports this in runs that are started cold.

``SIGNAL_AT=FOLDER:STEP:SIGNAL`` sends a signal to the process itself before it opens, renames or
makes something below the folder for the so-manieth time, from 1. Not before it removes something:
an exception in the hook would keep it from that.
"""

import os
import sys
from collections.abc import Callable

STEPS = ("open", "os.rename", "os.mkdir")
"""Operations on files, as Python's audit names them."""


def at_each_step(
    folder: str, call: Callable[[int], object], steps: tuple[str, ...] = STEPS
) -> None:
    """Call something with the number of each step of this process, before it is done."""
    number = 0

    def count(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal number
        if event in steps and folder in str(arguments[0]):
            number += 1
            call(number)

    sys.addaudithook(count)


if "SIGNAL_AT" in os.environ:
    _folder, _step, _signal = os.environ["SIGNAL_AT"].split(":")
    at_each_step(_folder, lambda n: n == int(_step) and os.kill(os.getpid(), int(_signal)))
