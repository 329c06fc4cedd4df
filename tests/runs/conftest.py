# SPDX-License-Identifier: MIT
"""A drive in the frame of a map, which several tests predict."""

from pathlib import Path

import pytest
from map_drives import drive
from narrow_network import narrow_salsanext
from scans import SMALL, write_bin, write_weights

from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.runs.network_settings import NetworkSettings


@pytest.fixture(scope="session")
def map_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the scans of such a drive, and weights of few channels."""
    folder = tmp_path_factory.mktemp("map")
    for number, scan in enumerate(drive()):
        write_bin(folder / "velodyne" / f"{number:06}.bin", scan)
    with narrow_salsanext():
        write_weights(folder / "w.safetensors", sensor=SMALL)
    return folder


@pytest.fixture(scope="session")
def predicted_map(map_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an output folder of `predict` on the drive, with what later stages need."""
    out = tmp_path_factory.mktemp("out")
    network = NetworkSettings(map_drive / "w.safetensors", "cpu", engine="torch")
    extras = ("probabilities", "pixel_labels")
    with narrow_salsanext():
        predict_scans(map_drive / "velodyne", out, settings=network, extras=extras)
    return out
