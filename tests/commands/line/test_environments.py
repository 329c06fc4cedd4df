# SPDX-License-Identifier: MIT
"""Places and settings of users: names, permissions, locale, no home, and large scans."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import called, only_json
from scans import files_below, make_scan, write_bin

from salsanext_cli import read_labels
from salsanext_cli.core.records import Scan

NETWORK = ("--device", "cpu", "--engine", "torch", "--json")
MANY_POINTS = 3_000_000


def state(folder: Path) -> dict[Path, int]:
    """Return the time of the last change of a folder and of all in it."""
    return {path: path.stat().st_mtime_ns for path in [folder, *folder.rglob("*")]}


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Make a scan with umlauts in its name and its folder."""
    folder = tmp_path / "Straße zur Mühle"
    write_bin(folder / "Fahrt ü 1.bin", make_scan())
    return folder


def test_a_folder_of_scans_that_may_only_be_read_stays_as_it_is(drive, weights, tmp_path):
    for path in (*drive.iterdir(), drive):
        path.chmod(0o555 if path.is_dir() else 0o444)
    before = state(drive)
    out = tmp_path / "Ergebnis"
    try:
        result = only_json(called("predict", drive, out, "--weights", weights, *NETWORK))
        assert (result["done"], result["failures"]) == (1, [])
        for command in (["export-ply", out], ["inspect", drive]):
            called(*command, "--json")
        assert state(drive) == before
    finally:
        drive.chmod(0o755)
    assert len(read_labels(out / f"sequences/{drive.name}/predictions/Fahrt ü 1.label")) == 1500


@pytest.mark.slow
def test_a_scan_of_three_million_points_is_labelled(tmp_path, weights):
    random = np.random.default_rng(0)
    scan = make_scan(30_000)
    points = np.repeat(scan.points, MANY_POINTS // len(scan), axis=0)
    points += random.normal(0, 0.01, points.shape).astype(np.float32)
    intensity = np.repeat(scan.intensity, MANY_POINTS // len(scan))
    write_bin(tmp_path / "survey/1.bin", Scan(points, intensity))
    result = only_json(
        called("predict", tmp_path / "survey", tmp_path / "out", "--weights", weights, *NETWORK)
    )
    assert (result["done"], result["failures"]) == (1, [])
    labels = read_labels(tmp_path / "out/sequences/survey/predictions/1.label")
    assert len(labels) == MANY_POINTS
    assert len(np.unique(labels)) > 2


@pytest.mark.slow
def test_without_a_home_in_the_c_locale_the_labels_are_the_same(drive, full_weights, tmp_path):
    names = ("PATH", "PYTHONPATH", "OMP_NUM_THREADS", "SYSTEMROOT", "TMPDIR")
    plain = {name: os.environ[name] for name in names if name in os.environ}
    usual = {**plain, "HOME": str(tmp_path), "LC_ALL": "C.UTF-8"}
    bare = {**plain, "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
    results = []
    for environment in (usual, bare):
        out = tmp_path / f"out {len(results)}"
        words = ["predict", str(drive), str(out), "--weights", str(full_weights), *NETWORK]
        done = subprocess.run(
            [sys.executable, "-m", "salsanext_cli", *words],
            capture_output=True,
            timeout=300,
            check=False,
            env=environment,
        )
        assert done.returncode == 0, done.stderr
        results.append(files_below(out / "sequences"))
    assert results[0] == results[1]
    assert len(results[0]) > 1
