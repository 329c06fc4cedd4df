# SPDX-License-Identifier: MIT
"""Fusion of arrays, as the stage `fuse` does it with files."""

from collections.abc import Sequence

import numpy as np

from salsanext_cli import Scan, label_space
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.fusion.pose_checks import fitting_parts
from salsanext_cli.core.fusion.reach import FusionReach
from salsanext_cli.core.fusion.votes import Tally
from salsanext_cli.core.fusion.window import FusionWindow
from salsanext_cli.core.poses import Poses
from salsanext_cli.core.records import Float


def fuse(
    scans: Sequence[Scan],
    probabilities: Sequence[Float],
    poses: Poses,
    reach: FusionReach = FusionReach(),
) -> list[Tally]:
    """Return the votes on the points of each scan, by softmax (N, C) and poses (S, 4, 4)."""
    softmax = [np.asarray(of_scan, np.float32) for of_scan in probabilities]
    parts, _ = fitting_parts(poses, lambda index: scans[index].points)
    window = FusionWindow(
        Drive(poses, parts),
        lambda index: (scans[index].points, softmax[index]),
        reach,
        label_space().movable,
    )
    return [window.tally(index) for index in range(len(scans))]
