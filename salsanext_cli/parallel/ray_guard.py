# SPDX-License-Identifier: MIT
"""Program that ends what is left of a local Ray when the process that started it has ended.

The system ends Ray's first processes with their parent, but their agents then ask a server that is
gone for a minute before they end too.
"""

import os
import shutil
import signal
import stat
import sys
import time
from contextlib import suppress
from pathlib import Path

SCANS = 10
INTERVAL_S = 0.3
"""Time between two scans of the processes: one that dies may be starting another."""


def kill_writers(folder: str, driver: int) -> bool:
    """Kill the processes that write files below a folder, and return whether there were any.

    `folder`: folder of the files of one Ray and of nothing else, absolute, without links; `driver`:
    process that is left alone: the one that started this Ray.
    """
    found = False
    for process in Path("/proc").glob("[0-9]*"):
        # Of other users' processes the files are not shown, and a process may end at any time.
        with suppress(OSError):
            if process.name != str(driver) and _writes_below(process, f"{folder}/"):
                os.kill(int(process.name), signal.SIGKILL)
                found = True
    return found


def _writes_below(process: Path, beginning: str) -> bool:
    for file in (process / "fd").iterdir():
        with suppress(FileNotFoundError):
            # The mode of such a link says what the file is open for.
            if file.lstat().st_mode & stat.S_IWUSR and str(file.readlink()).startswith(beginning):
                return True
    return False


def main(driver: int, folder: str) -> None:
    """Wait for the end of stdin, which the driver holds open; end its Ray and remove its folder."""
    sys.stdin.read()
    for _ in range(SCANS):
        if not kill_writers(folder, driver) and os.getppid() == driver:
            break
        time.sleep(INTERVAL_S)
    shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
