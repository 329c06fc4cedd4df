# SPDX-License-Identifier: MIT
"""Poses as origins of the scans of a map."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from las_files import write_las
from map_drives import WAY, write_poses
from narrow_network import narrow  # noqa: F401
from scans import SMALL
from street_scans import street

from salsanext_cli import fit_network
from salsanext_cli.commands.stages.fuse import fuse_results
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.runs.drives.poses_of_sequence import registered_drive
from salsanext_cli.runs.fit.pose_origins import (
    OriginsByPoses,
    _agreeing_positions,
    origins_by_poses,
)
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.recorded_origins import recorded_origin
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_search import find_scans


@pytest.mark.slow
@pytest.mark.usefixtures("workers_in_process")
def test_poses_in_the_frame_of_the_scans_are_their_origins(map_drive, tmp_path, caplog):
    shutil.copytree(map_drive / "velodyne", tmp_path / "velodyne")
    write_poses(tmp_path / "poses.txt", np.array(WAY, float))
    network = NetworkSettings(map_drive / "w.safetensors", "cpu", engine="torch")
    out = tmp_path / "out"
    caplog.set_level("INFO")
    predict_scans(tmp_path / "velodyne", out, settings=network, extras=("probabilities",))
    assert str(tmp_path / "poses.txt") in caplog.text
    results = ResultFolder(out)
    fitted = fit_network(network.load(), tmp_path / "velodyne").sensor
    assert fitted.without_noise() == results.provenance.sensor()
    for file, place in zip(results.scans(), WAY, strict=True):
        assert recorded_origin(out, file, results.provenance.sensor()) == place
    assert fuse_results(out).done == len(WAY)
    fused = np.loadtxt(next(out.glob("fused/sequences/*/poses.txt"))).reshape(-1, 3, 4)
    assert np.array_equal(fused[:, :, 3], np.array(WAY))
    assert np.array_equal(fused[:, :, :3], np.tile(np.eye(3), (len(WAY), 1, 1)))


@pytest.mark.parametrize("shift", [(3, 0, 0), (0, 0, 2)])
def test_poses_elsewhere_are_not_the_origins_of_scans(map_drive, tmp_path, shift):
    shutil.copytree(map_drive / "velodyne", tmp_path / "velodyne")
    write_poses(tmp_path / "poses.txt", np.array(WAY, float) + shift)
    files = find_scans(tmp_path / "velodyne")
    for text in (None, "1 2 3\n"):
        if text is not None:
            (tmp_path / "poses.txt").write_text(text)
        by_poses = origins_by_poses(files, replace(SMALL, registered=True))
        assert by_poses.origins == {}
        (line,) = by_poses.lines
        assert line.startswith(f"{tmp_path / 'poses.txt'} is not used")
        assert origins_by_poses(files, SMALL) == OriginsByPoses()


@pytest.mark.parametrize("wrong", [0, 2, 3])
def test_a_wrong_pose_is_used_for_no_scan_and_the_others_are(map_drive, tmp_path, wrong):
    shutil.copytree(map_drive / "velodyne", tmp_path / "velodyne")
    positions = np.array(WAY, float)
    positions[wrong] += (20, 5, 0)
    write_poses(tmp_path / "poses.txt", positions)
    files = find_scans(tmp_path / "velodyne")
    by_poses = origins_by_poses(files, replace(SMALL, registered=True))
    seen = {file.name: place for file, place in zip(files, WAY, strict=True)}
    name = files[wrong].name
    assert by_poses.origins == {key: place for key, place in seen.items() if key != name}
    used, unused = by_poses.lines
    assert used.endswith(str(tmp_path / "poses.txt"))
    assert unused.startswith(str(tmp_path / "poses.txt"))
    assert unused.endswith(name)


def test_a_trajectory_in_map_coordinates_has_the_origins_of_las_scans(tmp_path):
    """Origins are in the local frame, which begins west of the first scan and east of the last."""
    pytest.importorskip("laspy")
    places = np.array([(504_996.0, 5_400_000.0, 312.0), (505_003.0, 5_400_000.0, 312.0)])
    for seed, place in enumerate(places):
        points = street(32, seed=seed).points + place
        write_las(tmp_path / f"velodyne/{seed}.las", points, offsets=place)
    write_poses(tmp_path / "poses.txt", places)
    files = find_scans(tmp_path / "velodyne")
    sensor = replace(SMALL, registered=True)
    by_poses = origins_by_poses(files, sensor)
    frames = [(500_000, 5_400_000, 0), (510_000, 5_400_000, 0)]
    expected = {file.name: tuple(p - f) for file, p, f in zip(files, places, frames, strict=True)}
    assert by_poses.origins == {name: tuple(map(float, p)) for name, p in expected.items()}
    registered = registered_drive(files, sensor, lambda file: by_poses.origins[file.name])
    np.testing.assert_array_equal(registered.poses[:, :3, 3], places)


def test_most_compared_scans_decide_about_poses():
    seen_from = {0: np.zeros(3), 4: np.ones(3), 8: np.full(3, 2.0), 9: np.full(3, 3.0)}
    poses = np.tile(np.eye(4), (10, 1, 1))
    for number, origin in seen_from.items():
        poses[number, :3, 3] = origin
    poses[0, :3, 3] += 5
    assert np.array_equal(_agreeing_positions([poses], seen_from), poses[:, :3, 3])
    other = poses.copy()
    other[4, :3, 3] += 5
    assert _agreeing_positions([other], seen_from) is None
    assert np.array_equal(_agreeing_positions([other, poses], seen_from), poses[:, :3, 3])
    assert _agreeing_positions([poses], {}) is None
