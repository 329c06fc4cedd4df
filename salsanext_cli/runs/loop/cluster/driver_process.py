# SPDX-License-Identifier: MIT
"""The driver of a cluster, as the main process starts and ends it.

No wait for it is without an end: two threads write to it and read from it, and a driver that is
silent for too long has ended.
"""

import logging
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from tempfile import TemporaryFile
from typing import IO, Any, cast

from salsanext_cli.core.notices import NOTICE
from salsanext_cli.runs.loop.cluster.messages import messages_from

DRIVER_END_TIMEOUT_S = 10.0  # For the driver to end its workers
END_NOTICE_AFTER_S = 1.0  # Of waiting for the end of the driver
MAX_SILENT_POLLS = 120
"""Polls without a message: a driver may wait a minute for its nodes, or for a lost cluster."""
POLL_INTERVAL_S = 1.0
THREAD_TIMEOUT_S = 5.0  # For threads whose pipes have ended
PROGRAM = "from salsanext_cli.runs.loop.cluster.driver_program import main; main()"

log = logging.getLogger(__name__)


class DriverProcess:
    """Driver that runs, with the pipes from and to it.

    Parameters
    ----------
    process : Popen
        The process.
    errors : BinaryIO
        File of what it prints.
    """

    def __init__(self, process: "subprocess.Popen[bytes]", errors: IO[bytes]) -> None:
        self.process = process
        self.errors = errors
        self.is_silent = False  # Whether it has not answered for too long
        self._outgoing: SimpleQueue[Any] = SimpleQueue()  # None after the last message
        self._incoming: SimpleQueue[Any] = SimpleQueue()  # The same
        self._threads = [
            threading.Thread(target=target, name="cluster-driver", daemon=True)
            for target in (self._write, self._read)
        ]
        for thread in self._threads:
            thread.start()

    def send(self, message: object) -> None:
        """Send a message, which a driver that has ended does not get."""
        self._outgoing.put(message)

    def messages(self) -> Iterator[Any]:
        """Yield the messages of the driver until it ends, or is silent for too long."""
        silent_polls = 0
        while silent_polls < MAX_SILENT_POLLS:
            try:
                # Polls are counted instead of seconds: this process may be stopped for a while.
                message = self._incoming.get(timeout=POLL_INTERVAL_S)
            except Empty:
                silent_polls += 1
                continue
            if message is None:
                return
            silent_polls = 0
            yield message
        self.is_silent = True

    def ending(self) -> str:
        """Return why a driver sends no more: its silence, or its exit status and last line."""
        if self.is_silent:
            return f"does not answer within {MAX_SILENT_POLLS * POLL_INTERVAL_S:.0f} s"
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(DRIVER_END_TIMEOUT_S)
        self.errors.seek(0)
        lines = self.errors.read().decode(errors="replace").strip().splitlines()
        last_line = f": {lines[-1]}" if lines else ""
        return f"ended with status {self.process.returncode}{last_line}"

    def end(self) -> None:
        """Let the driver end its workers and itself.

        It is killed if it does not, or if this is interrupted.
        """
        self._outgoing.put(None)
        try:
            if not (self.is_silent or self._has_ended(END_NOTICE_AFTER_S)):
                log.log(NOTICE, "the workers of the cluster are being ended")
                self._has_ended(DRIVER_END_TIMEOUT_S - END_NOTICE_AFTER_S)
        finally:
            # Ray ends the workers of a driver that is killed.
            self.process.kill()
            # Its pipes, which are closed next, end both.
            for thread in self._threads:
                thread.join(THREAD_TIMEOUT_S)

    def _has_ended(self, timeout: float) -> bool:
        """Wait for the end of the driver, in seconds; return whether it has ended."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(timeout)
        return self.process.returncode is not None

    def _write(self) -> None:
        """Write messages into the input of the driver, and close it after the last."""
        stream = cast(IO[bytes], self.process.stdin)
        with suppress(BrokenPipeError), stream:
            for message in iter(self._outgoing.get, None):
                pickle.dump(message, stream)
                stream.flush()

    def _read(self) -> None:
        """Read the messages of the driver until it ends."""
        try:
            for message in messages_from(cast(IO[bytes], self.process.stdout)):
                self._incoming.put(message)
        finally:
            self._incoming.put(None)


@contextmanager
def driver_process() -> Iterator[DriverProcess]:
    """Start a driver, which ends with the body, and also if this process is killed."""
    # It imports the modules of this process; the folder that it starts in has none of its own.
    path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path)  # noqa: PTH100 - texts
    errors = TemporaryFile()  # noqa: SIM115 - closed below
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=errors,
        cwd=os.path.abspath(os.sep),  # noqa: PTH100 - the root
        # Under `uv run`, Ray would start the workers by uv, too, which the nodes may lack.
        env={**os.environ, "PYTHONPATH": path, "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0"},
        # A signal of the terminal reaches only the main process, which ends the driver.
        start_new_session=True,
    )
    with errors, process:
        driver = DriverProcess(process, errors)
        try:
            yield driver
        finally:
            driver.end()
