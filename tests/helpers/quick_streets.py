# SPDX-License-Identifier: MIT
"""Scans of three points in the place of those of a street, which takes a second to build."""

from collections.abc import Iterator

import numpy as np

from salsanext_cli import Scan
from salsanext_cli.synthesis.drive import Frame


def record(seed: int, sequence: int, scans: int, spacing: float, *_: object) -> Iterator[Frame]:
    """Yield scans as the function of the package does; each coordinate is the seed."""
    scan = Scan(np.full((3, 3), seed, np.float32), np.zeros(3, np.float32))
    for index in range(scans):
        yield Frame(
            scan=scan,
            labels=np.array([40, 40, 10], np.uint32),
            pose=np.eye(4),
            time=index * spacing,
        )
