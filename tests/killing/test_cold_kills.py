# SPDX-License-Identifier: MIT
"""The real command, killed or terminated at any moment: results stay, temporary files do not."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import chdir
from functools import cache
from pathlib import Path

import pytest
from command_line import called
from killing.file_steps import at_each_step
from killing.whole_files import require_alike, require_tidy, require_whole
from scans import SMALL, write_sequence, write_weights

import salsanext_cli

psutil = pytest.importorskip("psutil")

HERE = Path(__file__).parent
OUT = "folder-of-results"
"""A name that no other path contains."""
NETWORK = "--weights DATA/w.safetensors --device cpu"
PREDICT = f"predict DATA {OUT} --probabilities {NETWORK}"
COMMANDS = {
    "predict": (PREDICT,),
    "export-ply": (f"{PREDICT} --engine torch", f"export-ply {OUT} --colour label"),
    "eval": (PREDICT, f"eval {OUT}"),
    "knn-refine": (
        f"project DATA {OUT} --sensor DATA/small.toml",
        f"predict {OUT} {OUT} {NETWORK}",
        f"knn-refine {OUT}",
    ),
    "tune": (f"tune temperature DATA {OUT}/tuned.safetensors {NETWORK} --overwrite",),
}
"""Commands that are disturbed, after the commands that write their inputs."""
SHARED_MEMORY = Path("/dev/shm")
"""Folder in which joblib reserves the names of its own folders, by process."""
END_TIMEOUT_S = 10.0
"""Time in which all processes of a run end."""


@cache
def steps_seen() -> list[int]:
    """Return a list to which this process adds the number of each step from now on."""
    steps = [0]
    at_each_step(OUT, steps.append)
    return steps


def call(command: str) -> None:
    """Run a command to its end in this process."""
    called(*command.split())


class Trial:
    """A command, the folder that it starts from, and its undisturbed results."""

    def __init__(self, name: str, folder: Path, scans: int = 4) -> None:
        data, self.start, whole = (folder / name for name in ("data", "start", "whole"))
        stems = [f"{number:06d}" for number in range(scans)]
        write_sequence(data / "sequences/08", stems, count=400)
        write_weights(data / "w.safetensors")
        view = ("fov_up", "fov_down", "height", "width")
        (data / "small.toml").write_text("\n".join(f"{k} = {getattr(SMALL, k)}" for k in view))
        *before, self.command = (command.replace("DATA", str(data)) for command in COMMANDS[name])
        (self.start / OUT).mkdir(parents=True)
        with chdir(self.start):
            for command in before:
                call(command)
        shutil.copytree(self.start, whole)
        steps = steps_seen()
        first = steps[-1]
        with chdir(whole):
            call(self.command)
        self.steps = steps[-1] - first
        self.expected = whole / OUT

    def start_process(self, folder, options="", **environment):
        """Start the command in a new process and session, in a copy of the first folder."""
        shutil.copytree(self.start, folder, dirs_exist_ok=True)
        paths = os.pathsep.join(map(str, (Path(salsanext_cli.__file__).parents[1], HERE)))
        return subprocess.Popen(
            [sys.executable, "-m", "salsanext_cli", *self.command.split(), *options.split()],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": paths, "OMP_NUM_THREADS": "1", **environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    def require_completed(self, folder: Path, number: signal.Signals) -> None:
        """Fail if a file is partial, or another run does not complete the results."""
        require_whole(folder / OUT)
        with chdir(folder):
            call(self.command)
        require_alike(self.expected, folder / OUT)
        require_tidy(folder / OUT, killed=number == signal.SIGKILL)


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Trial]:
    """Return a cached function from a command to its trial."""
    return cache(lambda name: Trial(name, tmp_path_factory.mktemp(name)))


def end_timeout_s() -> float:
    """Return the time that a run has to end, which grows with the load of a shared machine."""
    load = os.getloadavg()[0] / (os.cpu_count() or 1)
    return END_TIMEOUT_S * max(1.0, load)


def require_ended(process: subprocess.Popen[str], number: signal.Signals) -> None:
    """Fail if a process of a run is left, or if the run ended in another way than by the signal."""
    timeout = end_timeout_s()
    output, _ = process.communicate(timeout=timeout)
    end = time.monotonic() + timeout
    while left := in_session(process.pid):
        assert time.monotonic() < end, left
        time.sleep(0.1)
    if number == signal.SIGKILL:
        assert process.returncode in (0, -signal.SIGKILL), output
    elif process.returncode not in (0, -number):
        assert process.returncode == 128 + number, output
        assert output.splitlines()[-1].startswith(("interrupted: ", "terminated: "))
        assert "Traceback" not in output


def in_session(leader: int) -> list[str]:
    """Return the command lines of the processes of a session."""
    lines = []
    for process in psutil.process_iter():
        try:
            if os.getsid(process.pid) == leader and process.status() != psutil.STATUS_ZOMBIE:
                lines.append(" ".join(process.cmdline()))
        except (psutil.Error, ProcessLookupError):
            continue
    return lines


def disturb(trial: Trial, folder: Path, number: signal.Signals, step: int) -> None:
    """Send a signal to a run at a step, and complete it by another run."""
    process = trial.start_process(folder, SIGNAL_AT=f"{OUT}:{step}:{number:d}")
    process.wait(timeout=120)
    assert process.returncode == {signal.SIGKILL: -signal.SIGKILL, signal.SIGTERM: 143}[number]
    require_ended(process, number)
    if number == signal.SIGTERM:
        require_tidy(folder / OUT)
    trial.require_completed(folder, number)


SLOW = (
    *((name, signal.SIGTERM, 12) for name in COMMANDS),
    *((name, signal.SIGKILL, 12) for name in ("knn-refine", "tune")),
)
"""`predict`, `synth` and `train` are killed at their steps in `test_killed_runs`."""


@pytest.mark.parametrize(
    ("name", "number", "most"),
    [
        ("export-ply", signal.SIGTERM, 1),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in SLOW),
    ],
)
def test_a_signal_at_a_step(tmp_path, trials, name, number, most):
    """At most `most` steps, evenly spaced."""
    trial = trials(name)
    spacing = max(1, trial.steps // most)
    for step in range((spacing + 1) // 2, trial.steps + 1, spacing):
        disturb(trial, tmp_path / f"{step}", number, step)


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> Trial:
    """Return a trial of many scans."""
    return Trial("predict", tmp_path_factory.mktemp("long"), scans=60)


@pytest.mark.slow
def test_two_runs_at_once(tmp_path: Path, long: Trial) -> None:
    folder = tmp_path / "trial"
    for process in [long.start_process(folder) for _ in range(2)]:
        output, _ = process.communicate(timeout=120)
        assert process.returncode == 0, output
    require_alike(long.expected, folder / OUT)
    require_tidy(folder / OUT)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_after_the_last_result_of_workers(tmp_path, trials, number):
    """The end of the process is cut short: its semaphores and folders are removed silently."""
    trial = trials("predict")
    process = trial.start_process(tmp_path, "--jobs 2", SIGNAL_AT_END=f"{number:d}")
    process.wait(timeout=120)
    assert process.returncode == 128 + number
    require_ended(process, number)
    require_alike(trial.expected, tmp_path / OUT)
    assert not list(SHARED_MEMORY.glob(f"*_{process.pid}_*"))


def when_working(folder: Path) -> None:
    """Wait until there are results."""
    end = time.monotonic() + 120
    while not list(folder.glob(f"{OUT}/sequences/*/predictions/*.label")):
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.slow
@pytest.mark.parametrize("whom", ["parent", "all"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL, signal.SIGTERM])
def test_signals_at_random_moments(tmp_path, long, number, whom):
    """As Docker sends them, to the first process, or as systemd and Ctrl-C do, to all."""
    draw = random.Random(f"{number} {whom}")
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    for turn in range(3):
        folder = tmp_path / f"{turn}"
        process = long.start_process(folder, "--jobs 2", TMPDIR=str(temporary))
        if turn % 2:
            when_working(folder)
        time.sleep(draw.uniform(0, 3))
        if whom == "parent":
            process.send_signal(number)
        else:
            os.killpg(process.pid, number)
        require_ended(process, number)
        if number != signal.SIGKILL or whom == "parent":  # The process that tidies up is left.
            assert not list(temporary.glob("salsanext-*"))
        long.require_completed(folder, number)
