# SPDX-License-Identifier: MIT
"""Kernels: threads, and folders where nothing can be cached."""

import os
import shutil
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import numpy as np
import pytest

import salsanext_cli
from salsanext_cli.kernels import SMALLEST_SLICE, argument, cache_folder, parallel_for_slices
from salsanext_cli.thread_pool import run_on_threads

PROJECT_ONE_POINT = """
import numpy as np
from salsanext_cli.geometry.projection import project
from salsanext_cli.records import Scan
from salsanext_cli.sensors import sensor
scan = Scan(np.array([[5, 0, 0]], np.float32), np.ones(1, np.float32))
assert project(scan, sensor("hdl64")).pixel_of_point.tolist() == [6 * 2048 + 1024]
"""


@pytest.mark.parametrize("count", [0, 1, SMALLEST_SLICE, 10 * SMALLEST_SLICE + 3])
def test_slices_cover_everything_once(count):
    visits = np.zeros(count, int)

    def visit(part):
        visits[part] += 1

    parallel_for_slices(visit, count)
    assert (visits == 1).all()


def test_arguments_are_copied_only_if_they_must_be():
    good = np.zeros((4, 3), np.float32)
    assert argument(good, np.float32) is good
    frozen = good.view()
    frozen.setflags(write=False)
    for other in (frozen, good[:, ::2], good.astype(np.float64)):
        flags = argument(other, np.float32).flags
        assert flags.writeable
        assert flags.c_contiguous


def test_kernels_work_without_a_cache(tmp_path):
    """A file stands where the cache folder would be, beside the source and in the home."""
    package = tmp_path / "salsanext_cli"
    shutil.copytree(
        Path(salsanext_cli.__file__).parent,
        package,
        ignore=shutil.ignore_patterns("__pycache__", "*.safetensors"),
    )
    (package / "geometry" / "__pycache__").touch()
    home = tmp_path / "home"
    home.touch()
    variables = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"), str(home))
    environment = {**os.environ, **variables, "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-B", "-c", PROJECT_ONE_POINT]
    subprocess.run(command, env=environment, cwd=tmp_path, check=True, timeout=120)


def test_kernels_are_kept_in_the_users_cache_folder(tmp_path, monkeypatch):
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment["XDG_CACHE_HOME"] = str(tmp_path)
    command = [sys.executable, "-c", PROJECT_ONE_POINT]
    subprocess.run(command, env=environment, check=True, timeout=120)
    compiled = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nbc")}
    assert compiled
    subprocess.run(command, env=environment, check=True, timeout=120)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nbc")} == compiled
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert all(path.is_relative_to(cache_folder()) for path in compiled)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", lambda: (_ for _ in ()).throw(RuntimeError("no home")))
    assert cache_folder() == ""
    # What other programs compile is kept elsewhere.
    assert "salsanext" not in numba.config.CACHE_DIR


def test_an_error_of_any_thread_is_raised_after_all_are_done():
    together, arrived, done = threading.Barrier(3, timeout=10), iter(range(3)), []

    def work():
        together.wait()
        if next(arrived) == 1:
            raise ValueError("no")
        time.sleep(0.05)
        done.append(1)

    with pytest.raises(ValueError, match="no"):
        run_on_threads(work, 3)
    assert len(done) == 2


def test_calls_on_busy_threads_are_cancelled(monkeypatch):
    busy = ThreadPoolExecutor(1)
    free = threading.Event()
    busy.submit(free.wait, 10)
    monkeypatch.setattr("salsanext_cli.thread_pool._pool", lambda _: busy)
    calls = []
    run_on_threads(lambda: calls.append(1), 3)
    assert calls == [1]
    free.set()
