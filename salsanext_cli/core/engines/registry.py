# SPDX-License-Identifier: MIT
"""Registry of the libraries that compute networks, and the choice among them.

A further library is a module with a `Backend`, and a row of `LIBRARIES`. The row declares all that
other modules ask about it: devices and number types for the choice of the engine, packages for
lists of versions, and its words for a lack of memory.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

from salsanext_cli.core.errors import MissingDependency, UsageError
from salsanext_cli.core.notices import warn_once
from salsanext_cli.core.wording import argument, setting

TYPE_CHECKING = False  # Importing it from `typing` takes time.
if TYPE_CHECKING:
    from salsanext_cli.core.engines.backend import Backend

AUTO = "auto"

log = logging.getLogger(__name__)


def starts() -> str:
    """Return that a library needs nothing else to start."""
    return ""


def _openvino_failure() -> str:
    """Return why OpenVINO cannot compute on this CPU, empty if it can."""
    from salsanext_cli.core.engines.openvino_runtime import openvino_failure

    return openvino_failure()


@dataclass(frozen=True, slots=True, kw_only=True)
class Library:
    """Library that computes networks.

    Attributes
    ----------
    name : str
        Name in options and records.
    title : str
        Name in messages.
    module, backend : str
        Module of its backend, which is imported when it computes, and the class in it.
    devices : tuple of str
        Kinds of devices on which it computes, ``"cpu"`` and ``"cuda"``.
    precisions : tuple of str
        Number types of layers in which it computes; float32 is one of them.
    packages : tuple of str
        Installed packages whose version may change a label.
    memory_errors : tuple of str
        Words in its errors, in lower case, when memory runs out, besides those of C++ and Python.
    gpu_memory_errors : tuple of str
        The same if the memory is that of a GPU.
    failure : callable
        Returns why it does not start on this machine; an empty text if it does.
    """

    name: str
    title: str
    module: str
    backend: str
    devices: tuple[str, ...]
    precisions: tuple[str, ...]
    packages: tuple[str, ...]
    memory_errors: tuple[str, ...] = ()
    gpu_memory_errors: tuple[str, ...] = ()
    failure: Callable[[], str] = starts

    def computes_on(self, device: str) -> bool:
        """Return whether it computes on a device, such as ``"cuda:1"``."""
        return device.partition(":")[0] in self.devices

    def backend_class(self) -> type[Backend]:
        """Import its backend."""
        backend: type[Backend] = getattr(import_module(self.module), self.backend)
        return backend


LIBRARIES = {
    "openvino": Library(
        name="openvino",
        title="OpenVINO",
        module="salsanext_cli.core.engines.openvino_backend",
        backend="OpenVinoBackend",
        devices=("cpu",),
        precisions=("float32", "bfloat16", "int8"),
        packages=("openvino",),
        memory_errors=("can't alloc",),
        failure=_openvino_failure,
    ),
    "torch": Library(
        name="torch",
        title="torch",
        module="salsanext_cli.core.engines.torch_backend",
        backend="TorchBackend",
        devices=("cpu", "cuda"),
        precisions=("float32", "bfloat16", "float16"),
        packages=("torch",),
        gpu_memory_errors=(
            "cuda out of memory",
            "cuda error: out of memory",
            "cublas_status_alloc_failed",
            "cudnn_status_alloc_failed",
            "cublas_status_not_initialized",
        ),
    ),
}
"""Libraries by name, the fastest first."""


def engine_names() -> tuple[str, ...]:
    """Return the names that `choose_engine` accepts."""
    return (AUTO, *LIBRARIES)


def choose_engine(name: str, device: str) -> str:
    """Return the engine of a name; ``"auto"`` is the fastest library that starts on a device.

    Parameters
    ----------
    name : str
        A name of `engine_names`.
    device : str
        ``"cpu"``, ``"cuda"``, ``"cuda:1"`` …

    Returns
    -------
    str
        Name in `LIBRARIES`.

    Raises
    ------
    UsageError
        If the name is unknown, or its library does not compute on the device.
    MissingDependency
        If the library does not start on this machine.
    """
    if name == AUTO:
        return _fastest_engine(device)
    library = LIBRARIES.get(name)
    if library is None:
        raise UsageError(argument("engine"), f"unknown engine {name}", ", ".join(engine_names()))
    if not library.computes_on(device):
        problem = f"{library.title} does not compute on {device}"
        hint = f"use {setting('device', library.devices[0])}"
        raise UsageError(argument("engine"), problem, hint=hint)
    failure = library.failure()
    if failure:
        raise MissingDependency(name, failure, hint=_hint_of_failure(library, device))
    return name


def _hint_of_failure(broken: Library, device: str) -> str:
    """Return what helps against a library that does not start: another one, if one starts."""
    hint = "install it again"
    for library in LIBRARIES.values():
        if library is not broken and library.computes_on(device) and not library.failure():
            return f"{hint}, or use {setting('engine', library.name)}"
    return hint


def _fastest_engine(device: str) -> str:
    """Return the first library that computes on a device and starts; warn of faster ones."""
    failures: dict[str, str] = {}
    for library in LIBRARIES.values():
        if not library.computes_on(device):
            continue
        failure = library.failure()
        if not failure:
            for name, reason in failures.items():
                slower = f"computing with {library.name}, which is slower"
                warn_once(log, f"{name}: {reason}; {slower}")
            return library.name
        failures[library.name] = failure
    raise UsageError(argument("device"), f"no library computes on {device}", "cpu or cuda")


def computes_int8(engine: str | None, device: str = "cpu") -> bool:
    """Return whether an engine computes layers in int8 on a device."""
    library = LIBRARIES.get(engine or "")
    return library is not None and "int8" in library.precisions and library.computes_on(device)


def int8_settings() -> str:
    """Return the settings by which the fastest library that computes int8 computes."""
    library = next(library for library in LIBRARIES.values() if "int8" in library.precisions)
    return f"{setting('device', library.devices[0])} and {setting('engine', library.name)}"


def library_packages() -> tuple[str, ...]:
    """Return the packages of all libraries."""
    return tuple(package for library in LIBRARIES.values() for package in library.packages)
