# SPDX-License-Identifier: MIT
"""Memory of this machine or GPU: all that a process may use, and what is available now."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class SystemFiles:
    """Files of Linux about memory."""

    meminfo: Path = Path("/proc/meminfo")
    groups_of_process: Path = Path("/proc/self/cgroup")
    groups: Path = Path("/sys/fs/cgroup")  # Folder of all control groups


SYSTEM = SystemFiles()


@dataclass(frozen=True, slots=True, kw_only=True)
class GroupFiles:
    """Files of a control group: its limit, its use, and the key of what it could free."""

    limit: str
    use: str
    cache: str


VERSION_1 = GroupFiles(
    limit="memory.limit_in_bytes", use="memory.usage_in_bytes", cache="total_inactive_file"
)
VERSION_2 = GroupFiles(limit="memory.max", use="memory.current", cache="inactive_file")


@dataclass(frozen=True, slots=True, kw_only=True)
class Memory:
    """Memory of a device, in bytes."""

    total: int  # What a process can have at most
    available: int  # What is free, or can be freed, now


def memory_of(device: str, system: SystemFiles = SYSTEM) -> Memory | None:
    """Return the memory of a device; None if it is unknown, as for a CPU outside Linux.

    A limit of the control group, as containers and clusters set it, counts as the memory of the
    machine.

    Parameters
    ----------
    device : str
        Such as "cpu" or "cuda:0".
    system : SystemFiles
        Files of Linux; another system has none.
    """
    if device.startswith("cuda"):
        import torch

        # Old versions of torch take no device without a number here.
        with torch.cuda.device(device):
            free, total = torch.cuda.mem_get_info()
            # Blocks that torch keeps for later tensors are not free for the driver.
            unused = torch.cuda.memory_reserved() - torch.cuda.memory_allocated()
        return Memory(total=total, available=free + unused)
    if device != "cpu" or not system.meminfo.exists():
        return None
    lines = (line.split() for line in system.meminfo.read_text("utf-8").splitlines())
    sizes = {words[0]: 1024 * int(words[1]) for words in lines if len(words) > 1}
    if not {"MemTotal:", "MemAvailable:"} <= sizes.keys():
        return None
    machine = Memory(total=sizes["MemTotal:"], available=sizes["MemAvailable:"])
    return _limited(machine, system)


def _limited(machine: Memory, system: SystemFiles) -> Memory:
    """Return the memory of a machine, or the lowest limit of the groups of this process."""
    total = machine.total
    available = machine.available
    for folder, files in _groups(system):
        limit = _number(folder / files.limit)
        used = _number(folder / files.use)
        if limit is not None and used is not None:
            used -= _cache(folder / "memory.stat", files.cache)
            total = min(total, limit)
            available = min(available, max(limit - used, 0))
    return Memory(total=total, available=available)


def _groups(system: SystemFiles) -> Iterator[tuple[Path, GroupFiles]]:
    """Yield the folders of the control groups of this process, up to the highest group."""
    try:
        lines = system.groups_of_process.read_text("utf-8").splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, name = line.split(":", 2)
        if "memory" in controllers.split(","):
            root = system.groups / "memory"
            files = VERSION_1
        elif not controllers:
            root = system.groups
            files = VERSION_2
        else:
            continue
        folder = root / name.lstrip("/")
        while folder != root and ".." not in folder.parts:
            yield folder, files
            folder = folder.parent
        yield root, files


def _number(path: Path) -> int | None:
    """Return the number in a file; None without one, also for the word "max"."""
    try:
        text = path.read_text("utf-8").strip()
    except OSError:
        return None
    return int(text) if text.isdecimal() else None


def _cache(path: Path, key: str) -> int:
    """Return the bytes of cached files that the system can free, 0 if they are unknown."""
    try:
        rows = (line.split() for line in path.read_text("utf-8").splitlines())
        return next(int(value) for name, value in rows if name == key)
    except (OSError, ValueError, StopIteration):
        return 0
