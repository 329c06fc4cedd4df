# SPDX-License-Identifier: MIT
"""OpenVINO in this process, and why it does not start."""

import sys
from functools import cache
from importlib import import_module
from typing import Any

from salsanext_cli.core.errors import MissingDependency
from salsanext_cli.core.interruptions import require_no_interruption
from salsanext_cli.core.texts import error_text

CONVERTER = "openvino.tools.ovc"
"""Part of OpenVINO that `import openvino` imports and that reports to a server of Google."""
OPENVINO_ERRORS = (AttributeError, ImportError, OSError, RuntimeError, TypeError, ValueError)
"""Errors of damaged installations and those of another platform."""


@cache
def openvino_core() -> Any:
    """Return the OpenVINO of this process."""
    # It stays loaded: the CPU plugin installs a stack for signal handlers and frees it when it is
    # unloaded, so that the next signal would end the process.
    openvino = import_openvino()
    # Called here, because two threads that call it first would deadlock.
    openvino.Type.f32.to_dtype()
    core = openvino.Core()
    # Without this, the threads of all workers would be bound to the same cores.
    core.set_property("CPU", {"ENABLE_CPU_PINNING": False})
    return core


@cache
def openvino_failure() -> str:
    """Return why OpenVINO cannot compute on this CPU, empty if it can."""
    try:
        openvino_core().get_property("CPU", "FULL_DEVICE_NAME")
    except MissingDependency as error:
        return error.problem
    except OPENVINO_ERRORS as error:
        require_no_interruption(error)
        return f"does not start: {error_text(error)}"
    return ""


def import_openvino() -> Any:
    """Import OpenVINO without its converter."""
    is_loaded = CONVERTER in sys.modules
    sys.modules.setdefault(CONVERTER, None)  # type: ignore[arg-type]
    try:
        return import_module("openvino")
    except OPENVINO_ERRORS as error:
        require_no_interruption(error)
        problem = f"cannot be imported: {error_text(error)}"
        raise MissingDependency("openvino", problem, hint="install it again") from error
    finally:
        if not is_loaded:
            sys.modules.pop(CONVERTER, None)
