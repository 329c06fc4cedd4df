# SPDX-License-Identifier: MIT
"""Workers as torchrun starts them, but forked by one process: each would import torch for seconds.

As a program, this file starts groups of workers side by side, and prints their exit status.
"""

import gc
import importlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import salsanext_cli

TESTS = Path(__file__).parents[1]
FOLDERS = (Path(salsanext_cli.__file__).parents[1], TESTS, TESTS / "helpers")
ENVIRONMENT = {"PYTHONPATH": os.pathsep.join(map(str, FOLDERS)), "OMP_NUM_THREADS": "1"}
MAX_S = 150
"""Time after which a worker is killed that has not ended."""


@dataclass(frozen=True, kw_only=True)
class Group:
    """Workers that call a function of a module of `tests/training`."""

    module: str
    function: str
    size: int


@dataclass(frozen=True, kw_only=True)
class GroupEnd:
    """Exit status of the workers of a group, and their messages on stderr, by rank."""

    status: list[int]
    messages: list[str]


def ends_of(folder: Path, *groups: Group) -> list[GroupEnd]:
    """Run groups of workers, whose functions take a folder; return how they end."""
    done = subprocess.run(
        [sys.executable, __file__, str(folder), json.dumps([asdict(group) for group in groups])],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | ENVIRONMENT,
    )
    assert done.returncode == 0, done.stderr
    ends = []
    for number, status in enumerate(json.loads(done.stdout)):
        files = [messages_file(folder, number, rank) for rank in range(len(status))]
        ends.append(GroupEnd(status=status, messages=[file.read_text("utf-8") for file in files]))
    return ends


def messages_file(folder: Path, group: int, rank: int) -> Path:
    """Return the file of the messages of a worker."""
    return folder / f"messages-{group}-{rank}.txt"


def free_port() -> int:
    """Return a port that no process uses."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def become_worker(messages: Path, environment: dict[str, str]) -> None:
    """Give this process the environment of a worker, a file as its stderr, and an end."""
    os.environ |= environment
    with messages.open("wb") as file:
        os.dup2(file.fileno(), 2)
    signal.alarm(MAX_S)


def main() -> None:
    """Fork the workers, whose interpreters end as those of torchrun, and wait for them."""
    from training import failing_workers, two_workers

    # Otherwise each worker that trains would import it, for seconds.
    importlib.import_module("torch._dynamo")
    gc.freeze()  # A worker that ends need not search for garbage in what it shares.
    modules = {module.__name__: module for module in (failing_workers, two_workers)}
    folder = Path(sys.argv[1])
    groups = [Group(**fields) for fields in json.loads(sys.argv[2])]
    processes: list[list[int]] = []
    for number, group in enumerate(groups):
        work: Callable[[Path], None] = getattr(modules[group.module], group.function)
        environment = {"TORCHELASTIC_RUN_ID": "test", "WORLD_SIZE": f"{group.size}"}
        environment |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": f"{free_port()}"}
        processes.append([])
        for rank in range(group.size):
            process = os.fork()
            if not process:
                become_worker(
                    messages_file(folder, number, rank), environment | {"RANK": f"{rank}"}
                )
                work(folder)
                return
            processes[-1].append(process)
    status = [[os.waitstatus_to_exitcode(os.waitpid(p, 0)[1]) for p in each] for each in processes]
    sys.stdout.write(json.dumps(status))


if __name__ == "__main__":
    main()
