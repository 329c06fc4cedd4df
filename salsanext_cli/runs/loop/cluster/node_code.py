# SPDX-License-Identifier: MIT
"""What runs on the nodes of a cluster: a check of the node, and the worker.

The driver sends the code of this module, so that a node without the package can name what it lacks.
The module therefore imports the standard library only, and functions import the package.
"""

import os
import pickle
import tempfile
import traceback
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

ARITHMETIC_HINT = "use nodes with CPUs of one kind, or another precision than int8"
FOLDERS_HINT = "let all nodes see the same folders under the same paths"
PACKAGE = "salsanext"
THREAD_VARIABLES = (
    "LOKY_MAX_CPU_COUNT",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
)
VERSIONS_HINT = "install the same versions on all nodes"


@dataclass(frozen=True, kw_only=True)
class ReadableFile:
    """File or folder that each node reads."""

    path: str  # Absolute
    size: int | None  # Bytes; None for a folder


@dataclass(frozen=True, kw_only=True)
class Probe:
    """File of a folder by whose content a node shows that it sees the same folder."""

    path: str  # Absolute
    content: bytes


@dataclass(frozen=True, kw_only=True)
class SharedFolder:
    """Folder of results that each node must see as the main process does."""

    path: str  # Absolute
    probe: Probe | None = None  # None if the main process cannot write one
    is_written: bool = False  # Whether the workers write into it


@dataclass(frozen=True, kw_only=True)
class NodeProblem:
    """What a node lacks, and what to do about it."""

    text: str  # Predicate of a sentence about the node
    hint: str = ""
    trace: str = ""  # Traceback of a problem that no user can correct


@dataclass(frozen=True, kw_only=True)
class NodeRequirements:
    """What each node needs to attempt the scans of a run.

    Attributes
    ----------
    versions : dict
        Version of the package and of each library, by name.
    files : tuple of ReadableFile
        Files that a node must see as the main process does.
    folders : tuple of SharedFolder
        Folders of results.
    int8_arithmetic : str
        How the CPU of the main process computes int8; empty for other number types.
    modules : frozenset of str
        Names of the modules of packages that are installed where the main process is.
    """

    versions: dict[str, str]
    files: tuple[ReadableFile, ...] = ()
    folders: tuple[SharedFolder, ...] = ()
    int8_arithmetic: str = ""
    modules: frozenset[str] = frozenset()


def installed_versions(libraries: Iterable[str]) -> dict[str, str]:
    """Return the versions of the package and of libraries; empty texts for absent ones."""
    versions = {PACKAGE: ""}
    with suppress(ImportError):
        versions[PACKAGE] = import_module("salsanext_cli.version").__version__
    for name in libraries:
        try:
            # Builds for another device have another text after the sign.
            versions[name] = version(name).partition("+")[0]
        except PackageNotFoundError:
            versions[name] = ""
    return versions


def node_problem(required: NodeRequirements) -> NodeProblem | None:
    """Return what this node lacks; None if it lacks nothing."""
    libraries = [name for name in required.versions if name != PACKAGE]
    text = version_problem(required.versions, installed_versions(libraries))
    if text:
        return NodeProblem(text=text, hint=VERSIONS_HINT)
    text = plug_in_problem(required.versions)
    if text:
        return NodeProblem(text=text, hint=VERSIONS_HINT)
    text = arithmetic_problem(required.int8_arithmetic)
    if text:
        return NodeProblem(text=text, hint=ARITHMETIC_HINT)
    for file in required.files:
        text = reading_problem(file)
        if text:
            return NodeProblem(text=text, hint=FOLDERS_HINT)
    for folder in required.folders:
        text = sharing_problem(folder)
        if text:
            return NodeProblem(text=text, hint=FOLDERS_HINT)
    return None


def version_problem(required: dict[str, str], installed: dict[str, str]) -> str:
    """Return which version is another one than that of the main process, in words."""
    for name, expected in required.items():
        actual = installed[name]
        if actual != expected:
            if not actual:
                return f"lacks {name}, which is {expected} here"
            return f"has {name} {actual}, which is {expected or 'missing'} here"
    return ""


def plug_in_problem(required: dict[str, str]) -> str:
    """Return which plug-ins the main process lacks, in words; `required`: versions by name."""
    from salsanext_cli.core.plug_ins import plug_in_packages

    surplus = [name for name in plug_in_packages() if name not in required]
    return f"has the plug-ins of {surplus[0]}, which is missing here" if surplus else ""


def arithmetic_problem(required: str) -> str:
    """Return in which other way the CPU of this node computes int8, in words."""
    if not required:
        return ""
    from salsanext_cli.core.engines.device import int8_arithmetic

    actual = int8_arithmetic()
    return "" if actual == required else f"computes int8 with {actual} instead of {required}"


def missing_module(error: BaseException | None) -> str:
    """Return the package that was not found, if that is a cause of an error; else an empty text."""
    while error is not None:
        if isinstance(error, ModuleNotFoundError) and error.name:
            return error.name.partition(".")[0]
        error = error.__cause__
    return ""


def reading_problem(file: ReadableFile) -> str:
    """Return why a file cannot be read, or is another one, in words."""
    try:
        size = os.stat(file.path).st_size  # noqa: PTH116 - the path is a text
        if file.size is None:
            os.listdir(file.path)  # noqa: PTH208 - the same
        else:
            with Path(file.path).open("rb") as opened:
                opened.read(1)
    except OSError as error:
        return f"cannot read {file.path}: {error.strerror}"
    if file.size not in (None, size):
        return f"has another {file.path}, of {size} bytes instead of {file.size}"
    return ""


def sharing_problem(folder: SharedFolder) -> str:
    """Return why a folder is not that of the main process, or cannot be written, in words."""
    problem = reading_problem(ReadableFile(path=folder.path, size=None))
    if problem:
        return problem
    if folder.probe and not contains(folder.probe):
        return f"has another {folder.path}, which lacks a file that was written here"
    return writing_problem(folder.path) if folder.is_written else ""


def contains(probe: Probe) -> bool:
    """Return whether the file of a probe exists here with its content."""
    try:
        return Path(probe.path).read_bytes() == probe.content
    except OSError:
        return False


def writing_problem(folder: str) -> str:
    """Return why no file can be written into a folder, in words."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return ""
    except OSError as error:
        return f"cannot write into {folder}: {error.strerror}"


class NodeWorker:
    """Worker of a run: it opens the task once, and attempts one chunk of scans after the other.

    Parameters
    ----------
    work : bytes
        Pickled `Work` of the module `work`.
    threads : int
        Number of threads for torch, OpenVINO and the kernels.
    """

    def __init__(self, work: bytes, threads: int) -> None:
        for name in THREAD_VARIABLES:
            os.environ[name] = str(threads)
        self.packed = work
        self.work: Any = None
        self.required: NodeRequirements | None = None
        self.probes: list[Probe] = []  # Of the folders that it writes into

    def node(self) -> str:
        """Return the id of the node."""
        import ray

        return str(ray.get_runtime_context().get_node_id())

    def process(self) -> int:
        """Return the id of this process, after all earlier calls: the next chunk starts."""
        return os.getpid()

    def open(self, required: NodeRequirements) -> NodeProblem | None:
        """Open the task; return why this node cannot, or None."""
        problem = node_problem(required)
        if problem:
            return problem
        self.required = required
        written = [folder for folder in required.folders if folder.is_written]
        self.probes = [folder.probe for folder in written if folder.probe]
        try:
            self.work = pickle.loads(self.packed)  # noqa: S301 - of the driver of this worker
            self.work.open()
        except Exception as error:  # noqa: BLE001 - any error concerns this node only
            # One that the user can correct has both.
            text = str(getattr(error, "headline", error)).replace("\n", "; ")
            hint = str(getattr(error, "hint", ""))
            is_correctable = hasattr(error, "headline") or isinstance(error, ImportError | OSError)
            return NodeProblem(
                text=f"cannot begin: {text or type(error).__name__}",
                hint=hint,
                trace="" if is_correctable else traceback.format_exc(),
            )
        return None

    def attempt(self, number: int, scans: bytes) -> bytes | NodeProblem:
        """Attempt a pickled chunk with a number; return the pickled attempts, or a `Bug`.

        After a failure, return what this node lacks by now, which may be the cause. This process
        ends if the run has ended, so that it writes into no folder of a later run.
        """
        from salsanext_cli.io.files.atomic import GUARD
        from salsanext_cli.runs.loop.cluster.bug import Bug

        GUARD.set(self.require_run)
        try:
            chunk = pickle.loads(scans)  # noqa: S301 - of the driver of this worker
            attempted = self.work.attempt(chunk, number)
            errors = [attempt.error for attempt in attempted.attempts if attempt.error]
            problem = self.fault_of_node(errors)
            if problem:
                return problem
            return pickle.dumps(attempted)
        except SystemExit:
            os._exit(1)  # noqa: TID251
        except Exception as error:  # noqa: BLE001 - the main process raises it
            return Bug.packed(error, traceback.format_exc())

    def fault_of_node(self, errors: list[Any]) -> NodeProblem | None:
        """Return what this node lacks after errors of scans, which it may have caused."""
        if not (self.required and errors):
            return None
        for module in map(missing_module, errors):
            if module in self.required.modules:
                text = f"lacks {module}, which is installed here"
                return NodeProblem(text=text, hint=VERSIONS_HINT)
        return node_problem(self.required)

    def require_run(self) -> None:
        """Raise `SystemExit` if the main process has removed a probe, which ends the run."""
        if not all(map(contains, self.probes)):
            raise SystemExit("the run has ended")
