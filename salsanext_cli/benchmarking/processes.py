# SPDX-License-Identifier: MIT
"""Both sides of a benchmark, each in a process of its own, waiting for its turn.

How a program takes memory is part of its speed, and the most that it took can be told of a process
only. This module imports nothing heavy, so that a process is told its number of threads before
any library looks for it.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

from salsanext_cli.errors import SalsanextError

if TYPE_CHECKING:
    from salsanext_cli.benchmarking.sides import Task

SIDES = ("baseline", "product")
THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def thread_variables(threads: int | None) -> dict[str, str]:
    """Return what the environment must say for so many threads; nothing for as many as usual."""
    return dict.fromkeys(THREADS, str(threads)) if threads else {}


class Line:
    """What asks a side in its process, and gets its answers."""

    def __init__(self, name: str, connection: Connection) -> None:
        self.name, self.connection = name, connection

    def ask(self, question: object, *arguments: object) -> Any:
        """Return the answer to a question; what went wrong there is raised here."""
        try:
            self.connection.send((question, *arguments))
            answer = self.connection.recv()
        except (EOFError, ConnectionError) as error:
            remedy = "see what it said, and whether there was memory for it"
            raise SalsanextError(
                f"benchmark, {self.name}", "its process ended", remedy=remedy
            ) from error
        if isinstance(answer, SalsanextError):
            raise answer
        return answer


@contextmanager
def served(task: Task, threads: int | None) -> Iterator[dict[str, Line]]:
    """Run both sides, each in its process, and end them."""
    context = multiprocessing.get_context("spawn")
    lines, processes = {}, []
    try:
        for name in SIDES:
            ours, theirs = context.Pipe()
            lines[name] = Line(name, ours)
            arguments = (name, thread_variables(threads), theirs)
            processes.append(context.Process(target=serve, args=arguments))
            processes[-1].start()
            theirs.close()
        for line in lines.values():
            line.ask(task)
        yield lines
    finally:
        for process in processes:
            process.terminate()
            process.join()
        for line in lines.values():
            line.connection.close()


def serve(name: str, environment: dict[str, str], line: Connection) -> None:
    """Take a task, then answer questions about one side, until nobody asks any more."""
    # Ctrl-C ends the process that asks, and that one ends this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.update(environment)
    watch = None
    while True:
        try:
            question, *arguments = line.recv()
        except EOFError:
            return
        try:
            if watch is None:
                from salsanext_cli.benchmarking.watch import Watch

                watch, answer = Watch(name, question), None
            else:
                answer = getattr(watch, question)(*arguments)
        except SalsanextError as error:
            answer = error
        line.send(answer)
