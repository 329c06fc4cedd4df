# SPDX-License-Identifier: MIT
"""Program of the driver process.

It reads messages of the main process from its input, and writes its own to its output.
"""

import os
import pickle
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from queue import SimpleQueue
from typing import Any

from salsanext_cli.runs.loop.cluster.calls import Calls
from salsanext_cli.runs.loop.cluster.driver import Driver
from salsanext_cli.runs.loop.cluster.error_lines import first_line, one_line
from salsanext_cli.runs.loop.cluster.messages import (
    Assignment,
    Crash,
    LostCluster,
    NotJoined,
    Send,
    messages_from,
)

MAIN_THREAD_TIMEOUT_S = 8.0  # For the main thread to end the workers after the last message
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

    calls: Calls = SimpleQueue()
    driver = Driver(ray_cluster, assignment, send, calls)
    threading.Thread(target=read, args=(messages, driver, calls), daemon=True).start()
    if not _joined(ray_cluster, assignment.address, send):
        return
    try:
        with suppress(BrokenPipeError):  # The main process has ended; the workers must end, too.
            if driver.begin():
                driver.run()
        driver.end()
    except ray_cluster.CONNECTION_ERRORS as error:
        send(LostCluster(problem=first_line(error)))


def _joined(cluster: Any, address: str, send: Send) -> bool:
    """Join a cluster, or report why that failed."""

    def give_up() -> None:
        send(NotJoined(problem=f"does not answer within {JOIN_TIMEOUT_S:.0f} s"))
        os._exit(1)  # noqa: TID251

    timer = threading.Timer(JOIN_TIMEOUT_S, give_up)
    timer.daemon = True
    timer.start()
    try:
        cluster.join(address)
    except cluster.JOIN_ERRORS as error:
        send(NotJoined(problem=one_line(error)))
        return False
    finally:
        timer.cancel()
    return True


def read(messages: Iterator[Any], driver: Driver, calls: Calls) -> None:
    """Let the main thread take the chunks that arrive, and end this process after the last message.

    Before the run has begun there is no worker to end. Later the main thread gets some time to end
    them; it may wait for a cluster that is lost.
    """
    try:
        for chunk in messages:
            calls.put(partial(driver.take, chunk))
    finally:
        if driver.has_begun:
            calls.put(driver.close)
            time.sleep(MAIN_THREAD_TIMEOUT_S)
        os._exit(0)  # noqa: TID251
