# SPDX-License-Identifier: MIT
"""Cache of compiled kernels: damaged, of other versions, and in folders that cannot be written."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

import salsanext_cli
from salsanext_cli.core.compiled import compiled
from salsanext_cli.io.files.user_cache import cache_folder


@pytest.fixture
def kernel(tmp_path, monkeypatch):
    """Return a function that compiles a small kernel as a new process, with a separate cache."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setitem(vars(numba.config), "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "small_kernel.py").write_text("def twice(x):\n    return 2 * x\n")

    def load():
        monkeypatch.delitem(sys.modules, "small_kernel", raising=False)
        importlib.invalidate_caches()
        return compiled(importlib.import_module("small_kernel").twice)

    return load


def cached_in(folder):
    return sorted(folder.rglob("*.nbc"))


def test_every_signature_of_a_kernel_is_cached(kernel, tmp_path):
    first = kernel()
    assert (first(2), first(1.5)) == (4, 3.0)
    assert len(cached_in(tmp_path)) == 2
    assert all(path.is_relative_to(cache_folder()) for path in cached_in(tmp_path))
    other = kernel()
    assert (other(2), other(1.5)) == (4, 3.0)
    assert sum(other.stats.cache_hits.values()) == 2
    assert not list(tmp_path.rglob("*.tmp*"))


DAMAGES = {
    "truncated": lambda content: content[: len(content) // 2],
    "empty": lambda content: b"",
    "other bytes": lambda content: content[::-1],
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_cache_is_one_warning_and_repaired(kernel, tmp_path, caplog, damage):
    first = kernel()
    assert (first(2), first(1.5)) == (4, 3.0)
    for file in cached_in(tmp_path):
        file.write_bytes(damage(file.read_bytes()))
    again = kernel()
    assert (again(2), again(1.5)) == (4, 3.0)
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "cache: " in caplog.text
    mended = kernel()
    assert (mended(2), mended(1.5)) == (4, 3.0)
    assert sum(mended.stats.cache_hits.values()) == 2


def test_machine_code_of_another_source_or_version_is_not_used(kernel, tmp_path, monkeypatch):
    assert kernel()(2) == 4
    for place in ("numba", "salsanext_cli.io.kernel_cache"):
        with monkeypatch.context() as patch:
            patch.setattr(f"{place}.__version__", "0.0.1")
            other = kernel()
            assert other(2) == 4
            assert not other.stats.cache_hits
    (tmp_path / "small_kernel.py").write_text("def twice(x):\n    return x + x + 1\n")
    assert kernel()(2) == 5


def test_a_cache_that_cannot_be_written(kernel, tmp_path, caplog, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device")

    first = kernel()
    monkeypatch.setattr("numba.core.caching.os.replace", fail)
    assert (first(2), first(1.5)) == (4, 3.0)
    assert len(caplog.records) == 1
    assert not any(path.is_file() for path in (tmp_path / "salsanext").rglob("*"))


@pytest.mark.slow
def test_processes_that_write_at_once(kernel, tmp_path):
    """They compile two signatures in different orders; afterwards both can be loaded."""
    code = (
        "import sys; from small_kernel import twice\n"
        "from salsanext_cli.core.compiled import compiled\n"
        "kernel, values = compiled(twice), [2, 1.5][:: int(sys.argv[1])]\n"
        "assert [repr(kernel(x)) for x in values] == [repr(2 * x) for x in values]\n"
        "print(sum(kernel.stats.cache_hits.values()))"
    )
    path = os.pathsep.join(map(str, (tmp_path, Path(salsanext_cli.__file__).parents[1])))
    pipes = {"env": os.environ | {"PYTHONPATH": path}, "stdout": subprocess.PIPE, "text": True}
    commands = [[sys.executable, "-c", code, order] for order in ("1", "-1")]
    started = [subprocess.Popen(command, **pipes) for command in commands]
    for process in started:
        process.communicate(timeout=120)
        assert process.returncode == 0
    last = subprocess.run(commands[0], **pipes, check=True, timeout=120)
    assert last.stdout == "2\n"


def test_kernels_work_without_a_cache(kernel, tmp_path, monkeypatch, caplog):
    """A file has the name of the cache folder; the folder of the source is writable."""
    (tmp_path / "home").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    assert [kernel()(2), kernel()(1.5)] == [4, 3.0]
    assert str(tmp_path / "home/salsanext/kernels") in caplog.text
    assert len(caplog.records) == 1
    assert not [*tmp_path.rglob("*.nb?")]
