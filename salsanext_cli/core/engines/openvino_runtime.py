# SPDX-License-Identifier: MIT
"""OpenVINO in this process, and why it does not start."""

from functools import cache
from typing import Any

from salsanext_cli.core.errors import MissingDependency
from salsanext_cli.core.optional_packages import OPENVINO_ERRORS, import_openvino
from salsanext_cli.core.texts import error_text


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
        return f"does not start: {error_text(error)}"
    return ""
