# SPDX-License-Identifier: MIT
"""The guard of a local Ray ends the processes of that Ray, and no others."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from salsanext_cli.parallel import ray_guard
from salsanext_cli.parallel.clusters import _guarded_folder

pytestmark = pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc")

HOLD = "import sys; file = open(sys.argv[1], sys.argv[2]); print(flush=True); sys.stdin.read()"


@contextmanager
def holding(path: Path, mode: str) -> Iterator[subprocess.Popen[bytes]]:
    """Start a process that holds a file open, as Ray's do with their logs."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", HOLD, path, mode], **pipes) as process:
        assert process.stdout
        process.stdout.readline()
        yield process


def test_only_what_writes_into_the_folder_of_this_run_ends(tmp_path: Path) -> None:
    driver = os.getpid()
    log = f"session_2026-01-01_00-00-00_000000_{driver}/logs/raylet.out"
    own = tmp_path / "ray-a"
    with ExitStack() as held:
        mine, reading, other, longer, outer = (
            held.enter_context(holding(path, mode))
            for path, mode in (
                (own / log, "a"),
                (own / log, "r"),
                # Another program's Ray may be of a process with the same number, long gone.
                (tmp_path / "ray" / log, "a"),
                (tmp_path / "ray-ab" / log, "a"),
                (tmp_path / "notes", "a"),
            )
        )
        with (own / "driver.log").open("w"):
            assert ray_guard.kill_writers(str(own), driver)
        assert mine.wait(10) == -9
        assert not ray_guard.kill_writers(str(own), driver)
        assert [each.poll() for each in (reading, other, longer, outer)] == [None] * 4


def test_the_folder_is_new_and_goes_with_its_writers(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path / "new"))
    with ExitStack() as held:
        with _guarded_folder() as folder, _guarded_folder() as other:
            assert Path(folder).parent == Path(other).parent == tmp_path / "new"
            process = held.enter_context(holding(Path(folder) / "session/logs/a", "w"))
            assert Path(folder) != Path(other)
        assert process.wait(10) == -9
        assert not list((tmp_path / "new").iterdir())
