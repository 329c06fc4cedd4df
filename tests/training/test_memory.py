# SPDX-License-Identifier: MIT
"""Memory of the machine, and the limit of a control group, from the files of Linux."""

from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from salsanext_cli.training import memory
from salsanext_cli.training.memory import Memory, SystemFiles, memory_of

MEMINFO = "MemTotal:       1000 kB\nMemFree: 10 kB\nMemAvailable:    600 kB\nHugePages_Total: 0\n"


@dataclass(frozen=True)
class FakeSystem:
    """Files of a system below a folder."""

    root: Path

    @property
    def files(self):
        return SystemFiles(
            meminfo=self.root / "meminfo",
            groups_of_process=self.root / "groups",
            groups=self.root / "cgroup",
        )

    def write(self, name, text):
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


@pytest.fixture
def system(tmp_path):
    """Return a system with 1000 KiB, of which 600 are free."""
    made = FakeSystem(tmp_path)
    made.write("meminfo", MEMINFO)
    return made


def kib(total, available):
    return Memory(total=1024 * total, available=1024 * available)


def test_without_a_limit_it_is_the_memory_of_the_machine(system):
    assert memory_of("cpu", system.files) == kib(1000, 600)
    system.write("groups", "0::/job\n")
    assert memory_of("cpu", system.files) == kib(1000, 600)
    system.write("cgroup/job/memory.max", "max\n")
    system.write("cgroup/job/memory.current", "1024\n")
    assert memory_of("cpu", system.files) == kib(1000, 600)


@pytest.mark.parametrize(
    ("groups", "folder", "files"),
    [
        ("0::/\n", "", memory.VERSION_2),
        ("0::/job_1/task_0\n", "job_1", memory.VERSION_2),  # The limit is that of the job
        ("0::/../elsewhere\n", "", memory.VERSION_2),
        ("5:cpu:/a\n4:memory:/docker/x\n0::/\n", "memory/docker/x", memory.VERSION_1),
        ("4:memory:/docker/x\n", "memory", memory.VERSION_1),  # A container sees its group as root
    ],
)
def test_a_control_group_limits_it_and_its_cached_files_are_free(system, groups, folder, files):
    system.write("groups", groups)
    system.write(f"cgroup/{folder}/{files.limit}", str(1024 * 500))
    system.write(f"cgroup/{folder}/{files.use}", str(1024 * 400))
    assert memory_of("cpu", system.files) == kib(500, 100)
    system.write(f"cgroup/{folder}/memory.stat", f"anon 5\n{files.cache} {1024 * 50}\n")
    assert memory_of("cpu", system.files) == kib(500, 150)
    # A limit above the memory of the machine limits nothing.
    system.write(f"cgroup/{folder}/{files.limit}", str(2**60))
    assert memory_of("cpu", system.files) == kib(1000, 600)


def test_that_of_a_gpu_is_stated_by_its_driver_and_includes_what_torch_keeps(monkeypatch):
    """Also where torch asks for the number of a device that it is not told to use."""
    used = []

    @contextmanager
    def on_device(device):
        used.append(device)
        yield
        used.pop()

    monkeypatch.setattr("torch.cuda.device", on_device)
    monkeypatch.setattr("torch.cuda.mem_get_info", lambda: {"cuda": (3, 80)}[used[-1]])
    monkeypatch.setattr("torch.cuda.memory_reserved", lambda: {"cuda": 50}[used[-1]])
    monkeypatch.setattr("torch.cuda.memory_allocated", lambda: {"cuda": 40}[used[-1]])
    assert memory_of("cuda") == Memory(total=80, available=13)


def test_it_is_unknown_elsewhere(system, tmp_path):
    """Another system has no such files; an old Linux states other numbers."""
    assert memory_of("cpu", FakeSystem(tmp_path / "elsewhere").files) is None
    system.write("meminfo", "MemTotal: 5 kB\n")
    assert memory_of("cpu", system.files) is None
