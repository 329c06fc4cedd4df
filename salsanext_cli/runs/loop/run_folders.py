# SPDX-License-Identifier: MIT
"""Folders of results of a run over scans."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class RunFolders:
    """Folders of results that the workers of a run use, on all nodes of a cluster the same ones.

    A folder may be in both.
    """

    writes: tuple[Path, ...] = ()  # Folders that the task writes into
    reads: tuple[Path, ...] = ()  # Folders whose results the task reads
