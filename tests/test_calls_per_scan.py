# SPDX-License-Identifier: MIT
"""No step is quadratic: twice as many scans take at most twice the calls of any function."""

import sys
import threading
from collections import Counter
from collections.abc import Callable
from contextlib import chdir
from functools import partial
from pathlib import Path
from types import FrameType

import pytest
from command_line import called
from scans import SMALL, write_sequence, write_weights
from tiny_network import TinyNetwork

import salsanext_cli
from salsanext_cli.core.network.registry import ARCHITECTURES
from salsanext_cli.runs.scans.selection import scans_of

PACKAGE = str(Path(salsanext_cli.__file__).parent)
CONSTANT_PER_SCAN = 10
"""Further calls that are accepted for each scan of the smaller run, since drawing depends on the
values. A quadratic step has `scans` times more."""


Calls = Counter[tuple[str, str, str]]
"""Numbers of calls, by the file and the name of the function, and the C function that it calls."""


def calls(run: Callable[[], object]) -> Calls:
    """Count the calls of the functions of the package, and their calls of C functions."""
    counts: Calls = Counter()

    def count(frame: FrameType, event: str, argument: object) -> None:
        code = frame.f_code
        if event in ("call", "c_call") and code.co_filename.startswith(PACKAGE):
            called = getattr(argument, "__qualname__", "") if event == "c_call" else ""
            counts[code.co_filename, code.co_qualname, called] += 1

    threading.setprofile(count)
    sys.setprofile(count)
    try:
        run()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    return counts


def require_linear(scans: int, few: Calls, many: Calls, name: object = "") -> None:
    """Fail if twice as many scans are more than twice the calls of a function."""
    most = CONSTANT_PER_SCAN * scans
    worse = {key: (few[key], many[key]) for key in many if many[key] > 2 * few[key] + most}
    assert not worse, name


@pytest.mark.parametrize(
    ("folder", "suffix", "source"),
    [("plain", ".CSV", "plain"), ("data/sequences/00/velodyne", ".pcd.bin", "data")],
)
def test_finding_scans(tmp_path: Path, folder: str, suffix: str, source: str) -> None:
    """Labels and pictures lie in the folder of the scans."""
    counts = []
    for scans in (100, 200):
        parent = tmp_path / f"{scans}" / folder
        parent.mkdir(parents=True)
        for number in range(scans):
            for end in (suffix, ".label", ".jpg"):
                (parent / f"{number:06d}{end}").touch()
        counts.append(calls(lambda s=scans: scans_of(tmp_path / f"{s}" / source)))
    require_linear(100, *counts)


NETWORK = "--weights WEIGHTS --device cpu --engine torch"
QUICK = (f"predict DATA out {NETWORK}", f"predict DATA out {NETWORK}", "eval out")
THOROUGH = (
    *QUICK,
    "project DATA steps --sensor small.toml",
    "project DATA steps --sensor small.toml",
    f"predict steps steps {NETWORK}",
    "knn-refine steps",
    "inspect DATA",
    f"predict DATA out {NETWORK} --probabilities --overwrite",
    "export-ply out",
    "export-ply out",
    "report out",
)
WITH_SAMPLES = (
    f"uncertainty DATA sampled {NETWORK} --samples 2",
    f"uncertainty DATA sampled {NETWORK} --samples 2",
    "eval sampled",
    "export-ply sampled --colour entropy",
    f"pick DATA picked {NETWORK} --count 1000",
    f"pick DATA picked {NETWORK} --count 1000",
    "import-labels DATA/sequences/08/labels picked",
    "import-labels DATA/sequences/08/labels picked",
    "tune risk DATA tuned.safetensors --at-most 99% --weights WEIGHTS --device cpu",
)
WITH_PICTURES = (f"uncertainty DATA sampled {NETWORK} --samples 2", "picture sampled")


def counts_of(folder: Path, commands, weights: Path, scans: int) -> list:
    """Run commands on scans; return the counts of their calls, which two scans do not need."""
    write_sequence(folder / "DATA/sequences/08", [f"{n:06d}" for n in range(scans)], count=60)
    (folder / "small.toml").write_text(SMALL.to_toml())
    counts = []
    for command in commands:
        words = command.replace("WEIGHTS", f"{weights}").split()
        with chdir(folder):
            counts.append(calls(partial(succeed, words)) if scans > 2 else succeed(words))
    return counts


def succeed(words: list[str]) -> None:
    called(*words)


@pytest.fixture
def tiny(tmp_path: Path, monkeypatch) -> Path:
    """Return weights of a network with hardly any calls."""
    monkeypatch.setitem(ARCHITECTURES, "salsanext", TinyNetwork)
    return write_weights(tmp_path / "tiny.safetensors")


@pytest.fixture
def unrendered(monkeypatch, request: pytest.FixtureRequest) -> None:
    """Write pictures that matplotlib does not draw; how long that takes depends on their size.

    To arrange them would take most of a quick test.
    """
    if not request.node.get_closest_marker("slow"):
        request.getfixturevalue("undrawn")
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda _, png, **__: png.write(b"PNG"))


@pytest.mark.parametrize(
    ("commands", "scans"),
    [
        (QUICK, 8),
        pytest.param(THOROUGH, 60, marks=[pytest.mark.slow, pytest.mark.long]),
        pytest.param(WITH_SAMPLES, 20, marks=[pytest.mark.slow, pytest.mark.long]),
        pytest.param(WITH_PICTURES, 12, marks=pytest.mark.slow),
    ],
    ids=["quick", "thorough", "sampled", "pictures"],
)
@pytest.mark.usefixtures("unrendered")
def test_steps_over_a_run(tmp_path: Path, tiny: Path, commands, scans: int) -> None:
    # The first run imports libraries and compiles kernels, which is slow with counting.
    numbers = (2, scans, 2 * scans)
    _, few, many = (counts_of(tmp_path / f"{n}", commands, tiny, n) for n in numbers)
    for command, *counts in zip(commands, few, many, strict=True):
        require_linear(scans, *counts, command)
