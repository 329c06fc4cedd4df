# SPDX-License-Identifier: MIT
"""Drives of registered scans, and poses that a command names for them."""

import shutil

import numpy as np
import pytest
from map_drives import WAY, write_poses

from salsanext_cli.commands.stages.fuse import fuse_results
from salsanext_cli.core.errors import UsageError


def test_poses_of_a_registered_drive_must_agree_with_its_scans(predicted_map, tmp_path):
    out, path = tmp_path / "out", tmp_path / "p.txt"
    shutil.copytree(predicted_map, out)
    write_poses(path, np.array(WAY, float))
    assert fuse_results(out, tmp_path / "fused", poses=path).done == len(WAY)
    write_poses(path, np.array(WAY, float) + (3, 0, 0))
    with pytest.raises(UsageError) as caught:
        fuse_results(out, tmp_path / "other", poses=path)
    assert caught.value.subject == "poses"
    assert "omit poses" in caught.value.hint
