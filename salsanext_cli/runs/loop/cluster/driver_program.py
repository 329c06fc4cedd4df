# SPDX-License-Identifier: MIT
"""Program of the driver process.

It reads messages of the main process from its input, and writes its own to its output.
"""

import os
import pickle
import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from queue import SimpleQueue
from typing import Any

from salsanext_cli.runs.loop.cluster.driver import Calls, Driver, Send, first_line, one_line
from salsanext_cli.runs.loop.cluster.messages import (
    Assignment,
    Crash,
    LostCluster,
    NotJoined,
    messages_from,
)

JOIN_TIMEOUT_S = 15.0


def main() -> None:
    """Run the driver of the main process that has started this one."""
    output = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    # Ray prints, and only messages may reach the main process, which keeps the errors.
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())

    def send(message: object) -> None:
        pickle.dump(message, output)
        output.flush()

    with suppress(BrokenPipeError):  # The main process has ended.
        try:
            drive(messages_from(sys.stdin.buffer), send)
        except Exception:  # noqa: BLE001 - the main process raises it
            send(Crash(trace=traceback.format_exc()))
    # Threads of Ray need not end, least of all after the loss of the cluster.
    os._exit(0)  # noqa: TID251


def drive(messages: Iterator[Any], send: Send) -> None:
    """Join the cluster of the first message, an assignment, and hand out the chunks that follow."""
    assignment: Assignment = next(messages)
    from salsanext_cli.runs.loop.cluster import ray_cluster

    if not _joined(ray_cluster, assignment.address, send):
        return
    try:
        calls: Calls = SimpleQueue()
        driver = Driver(ray_cluster, assignment, send, calls)
        if driver.begin():
            threading.Thread(target=_read, args=(messages, driver, calls), daemon=True).start()
            driver.run()
            driver.end()
    except ray_cluster.CONNECTION_LOST as error:
        send(LostCluster(problem=first_line(error)))


def _joined(cluster: Any, address: str, send: Send) -> bool:
    """Join a cluster, or report why that failed."""

    def give_up() -> None:
        send(NotJoined(problem=f"does not answer within {JOIN_TIMEOUT_S:.0f} s"))
        os._exit(1)  # noqa: TID251

    timer = threading.Timer(JOIN_TIMEOUT_S, give_up)
    timer.start()
    try:
        cluster.join(address)
    except cluster.NOT_JOINED as error:
        send(NotJoined(problem=one_line(error)))
        return False
    finally:
        timer.cancel()
    return True


def _read(messages: Iterator[Any], driver: Driver, calls: Calls) -> None:
    """Let the main thread take the chunks that arrive, and end after the last message."""
    for chunk in messages:
        calls.put(partial(driver.take, chunk))
    calls.put(driver.close)
