# SPDX-License-Identifier: MIT
"""A signal at a step of a run; `sitecustomize` imports this module.

With ``SIGNAL_AT=FOLDER:STEP:SIGNAL`` a process sends itself a signal before its n-th operation on a
file below the folder, from 1. Removals do not count: an exception in the hook would prevent them.
With ``SIGNAL_AT_END=SIGNAL`` the first process of a session sends itself a signal after its work,
before the functions of `atexit`.
"""

import os
import sys
import threading

STEPS = ("open", "os.rename", "os.mkdir")
"""Names of the operations in audit events of Python."""


def at_each_step(folder, call, steps=STEPS):
    """Call a function with the number of a step before every step of this process."""
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
if "SIGNAL_AT_END" in os.environ and os.getpid() == os.getsid(0):
    _at_end = int(os.environ["SIGNAL_AT_END"])
    threading._register_atexit(os.kill, os.getpid(), _at_end)
