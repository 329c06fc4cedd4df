# SPDX-License-Identifier: MIT
"""The driver of a cluster, as the main process starts and ends it."""

import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from tempfile import TemporaryFile
from typing import IO, Any, cast

from salsanext_cli.runs.loop.cluster.messages import messages_from

END_TIMEOUT_S = 10.0  # For the driver to end its workers
PROGRAM = "from salsanext_cli.runs.loop.cluster.driver_program import main; main()"


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
        self.input = cast(IO[bytes], process.stdin)
        self.output = cast(IO[bytes], process.stdout)

    def send(self, message: object) -> None:
        """Send a message, which a driver that has ended does not get."""
        with suppress(BrokenPipeError):
            pickle.dump(message, self.input)
            self.input.flush()

    def messages(self) -> Iterator[Any]:
        """Yield the messages of the driver until it ends."""
        return messages_from(self.output)

    def ending(self) -> str:
        """Return how a driver ended that sends no more: its exit status, and its last line."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(END_TIMEOUT_S)
        self.errors.seek(0)
        lines = self.errors.read().decode(errors="replace").strip().splitlines()
        last_line = f": {lines[-1]}" if lines else ""
        return f"ended with status {self.process.returncode}{last_line}"


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
        env={**os.environ, "PYTHONPATH": path},
        # A signal of the terminal reaches only the main process, which ends the driver.
        start_new_session=True,
    )
    with errors, process:
        try:
            yield DriverProcess(process, errors)
        finally:
            _end(process)


def _end(process: "subprocess.Popen[bytes]") -> None:
    """Close the input of the driver, and wait until it has ended its workers."""
    try:
        # This also reads what the driver still sends, which would wait otherwise.
        process.communicate(timeout=END_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        # Ray ends the workers of a driver that is killed.
        process.kill()
