# SPDX-License-Identifier: MIT
"""Program that ends what is left of a local Ray when the process that started it has ended.

The system ends Ray's first processes with their parent, but their agents then ask a server that is
gone for a minute before they end too.
"""

import os
import re
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

SCANS = 10
INTERVAL_S = 0.3
"""Time between two scans of the processes: one that dies may be starting another."""


def kill_ray_of(driver: int) -> bool:
    """Kill the processes that write logs of a Ray of a process, and return whether there were any.

    The name of the folder that they write into ends with the number of that process.
    """
    log = re.compile(rf"/session_[^/]+_{driver}/logs/")
    found = False
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            files = map(os.readlink, (process / "fd").iterdir())
            if process.name != str(driver) and any(map(log.search, files)):
                os.kill(int(process.name), signal.SIGKILL)
                found = True
    return found


def main(driver: int) -> None:
    """Wait for the end of stdin, which the driver holds open, and end its Ray."""
    sys.stdin.read()
    for _ in range(SCANS):
        if not kill_ray_of(driver) and os.getppid() == driver:
            break
        time.sleep(INTERVAL_S)


if __name__ == "__main__":
    main(int(sys.argv[1]))
