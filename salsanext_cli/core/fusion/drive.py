# SPDX-License-Identifier: MIT
"""Drives: the poses of the scans of a sequence, and the parts within which they fit."""

from dataclasses import dataclass

import numpy as np

from salsanext_cli.core.fusion.pose_checks import Parts
from salsanext_cli.core.poses import Poses


@dataclass(frozen=True, slots=True)
class Drive:
    """Poses of the scans of a drive, and the parts of the drive within which they fit."""

    poses: Poses  # (N, 4, 4)
    parts: Parts  # (N,)

    @property
    def origins(self) -> Poses:
        """Position (P, 3) of the first scan of each part, from which voxels are counted."""
        origins = np.zeros((self.parts.max(initial=-1) + 1, 3))
        origins[self.parts[::-1]] = self.poses[::-1, :3, 3]
        return origins
