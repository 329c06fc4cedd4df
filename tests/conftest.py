# SPDX-License-Identifier: MIT
"""Fixtures shared by all tests."""

import gc
import logging
import os
import signal
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from world import World

settings.register_profile("few", max_examples=15, deadline=None)
settings.register_profile("many", max_examples=400, deadline=None)
settings.load_profile("few")

MIN_NEW_OBJECTS = 20_000
"""Objects after which garbage is searched; after 700, as by default, it takes a twentieth of the
time."""

# On a processor that multiplies bfloat16 commands would choose that, and other bits.
os.environ.setdefault("SALSANEXT_PRECISION", "float32")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Search no garbage in what is imported, which takes a sixth of that time: all of it stays."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(MIN_NEW_OBJECTS)
        gc.enable()


COLLECTS_BACKWARDS = os.environ.get("PYTEST_XDIST_WORKER", "gw0")[-1] in "13579"
"""Whether this is every second of the processes that test."""


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Import the last files first in every second process.

    In a fresh clone, each of two processes compiles half of the files, and reads what the other one
    has compiled.
    """
    report = yield
    if COLLECTS_BACKWARDS and isinstance(collector, pytest.Directory):
        report.result.reverse()
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None, object, object]:
    """Leave the logger as it was, which a command line sets up as soon as it is parsed."""
    logger = logging.getLogger("salsanext_cli")
    level = logger.level
    handlers = [*logger.handlers]
    try:
        return (yield)
    finally:
        logger.setLevel(level)
        logger.handlers[:] = handlers


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the tests that are marked `long`; the others have the order of their files."""
    items.sort(key=lambda item: (item.get_closest_marker("long") is None, item.path.parts))


@pytest.fixture(autouse=True, scope="session")
def interruptible() -> Iterator[None]:
    """Heed Ctrl-C also where the tests were started in the background, which ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(autouse=True, scope="session")
def unsynced() -> Iterator[None]:
    """Leave it to the system when a file reaches the disk: no test cuts the power."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", os.fstat)  # which refuses a closed file too
        yield


@pytest.fixture(autouse=True)
def drawn_alike() -> Iterator[None]:
    """Let each test draw the same numbers of torch's global generator, and leave it as it was."""
    import torch

    with torch.random.fork_rng([]):
        # `torch.manual_seed` formats the stack for each kind of device that is absent.
        torch.default_generator.manual_seed(0)
        if torch.cuda.is_available():
            torch.cuda.manual_seed_all(0)
        yield


@pytest.fixture
def workers_in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let workers be copies of the task in this process, which has the patches of the test."""
    from worker_tasks import attempts_in_process

    monkeypatch.setattr("salsanext_cli.runs.loop.pool.attempts_of_workers", attempts_in_process)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Return the folder with `data/` (real scans) and `golden/` (published outputs), or skip."""
    folder = os.environ.get("SALSANEXT_REAL_DATA")
    if not folder or not Path(folder).is_dir():
        pytest.skip("SALSANEXT_REAL_DATA does not name a folder")
    return Path(folder)


@pytest.fixture(scope="session")
def golden(real_data: Path) -> Path:
    """Return the folder with outputs of the published implementation and the official evaluator."""
    return real_data / "golden"


@pytest.fixture(scope="session")
def full_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a weights file of a random network for the sensor `scans.SMALL`."""
    from scans import write_weights

    return write_weights(tmp_path_factory.mktemp("weights") / "random.safetensors")


@pytest.fixture(scope="session")
def weights(full_weights: Path) -> Path:
    """Return the same file, or one of a network of few channels, as `narrow_network.py` has it."""
    return full_weights


@pytest.fixture
def narrow_weights(tmp_path: Path) -> Iterator[Path]:
    """Return weights of few channels, which salsanext has as long as the test runs."""
    from narrow_network import narrow_salsanext
    from scans import write_weights

    with narrow_salsanext():
        yield write_weights(tmp_path / "narrow.safetensors")


@pytest.fixture
def take_by_default(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], None]:
    """Return a function that has a file of weights be the one that is taken if none is named."""
    from salsanext_cli.io.weights import card_file

    return lambda weights: monkeypatch.setattr(card_file, "DEFAULT_FILE", str(weights))


@pytest.fixture
def narrow_default(narrow_weights: Path, take_by_default: Callable[[Path], None]) -> Path:
    """Return such weights, which are also those that are taken if none are named."""
    take_by_default(narrow_weights)
    return narrow_weights


@pytest.fixture
def one_step_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fit error models in few steps: one for each epoch of few points."""
    from salsanext_cli.training.tuning import error_training

    monkeypatch.setattr(error_training, "MIN_STEPS", 1)


@pytest.fixture
def small_slices(monkeypatch: pytest.MonkeyPatch) -> None:
    """Divide the work of kernels among threads from 100 points on."""
    monkeypatch.setattr("salsanext_cli.core.compiled.MIN_SLICE_ITEMS", 100)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw no plots of results and no pixels of figures, which take tenths of a second."""
    from picture_stubs import draw_no_results

    draw_no_results(monkeypatch)


@pytest.fixture
def world(tmp_path: Path, weights: Path) -> "World":
    """Return scans in SemanticKITTI's layout, in a folder with a space and an umlaut."""
    from world import World

    return World.made(tmp_path, weights)


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep what is compiled below the folder of the test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def tiny_training(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Train a tiny network; its epochs are drawn, which takes longer, if a test is `drawn`."""
    from picture_stubs import draw_no_epochs
    from tiny_network import TinyNetwork

    from salsanext_cli.core.network.registry import ARCHITECTURES

    monkeypatch.setitem(ARCHITECTURES, "salsanext", TinyNetwork)
    if not request.node.get_closest_marker("drawn"):
        draw_no_epochs(monkeypatch)
