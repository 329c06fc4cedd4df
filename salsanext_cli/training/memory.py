# SPDX-License-Identifier: MIT
"""Memory that was freed is used again, instead of going back to the system at every step.

The activations of a step are large, and glibc asks the system for every large block anew: each step
the kernel hands out the same gigabytes page by page, and fills them with zeros.
"""

from __future__ import annotations

import ctypes
import platform

TRIM_THRESHOLD, MMAP_MAX = -1, -4
"""What `mallopt` of glibc calls them."""
NEVER = -1


def keep_freed_memory() -> bool:
    """Let this process keep what it frees until it ends; return whether that could be arranged.

    The most that it has ever used at a time is what it then occupies. Elsewhere than with glibc
    nothing changes.
    """
    if platform.libc_ver()[0] != "glibc":
        return False
    mallopt = ctypes.CDLL(None).mallopt
    return bool(mallopt(MMAP_MAX, 0) and mallopt(TRIM_THRESHOLD, NEVER))
