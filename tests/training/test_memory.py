# SPDX-License-Identifier: MIT
import ctypes
import platform
import subprocess
import sys

import pytest

from salsanext_cli.training.memory import keep_freed_memory

COUNT = """
import resource
from salsanext_cli.training.memory import keep_freed_memory
if {keep}:
    assert keep_freed_memory()
bytearray({size})
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(4):
    bytearray({size})
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
SIZE = 1 << 26


def faults(*, keep: bool) -> int:
    """Return how many pages a process of its own asks for when it takes a block four times."""
    source = COUNT.format(keep=keep, size=SIZE)
    return int(
        subprocess.run([sys.executable, "-c", source], capture_output=True, check=True).stdout
    )


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc only")
def test_memory_is_asked_for_once() -> None:
    assert 10 * faults(keep=True) < faults(keep=False)


def test_with_another_library_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "libc_ver", lambda: ("", ""))
    monkeypatch.setattr(ctypes, "CDLL", None)
    assert not keep_freed_memory()
