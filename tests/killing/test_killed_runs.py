# SPDX-License-Identifier: MIT
"""Runs that are killed at any moment, and begun again, lose nothing; see `killed_runs`."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import salsanext_cli

HERE = Path(__file__).parent
ROOT = Path(salsanext_cli.__file__).parents[1]

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")


def happened(folder: Path, *jobs: str) -> list[dict[str, Any]]:
    """Return what happened to jobs that `killed_runs` did."""
    places = os.pathsep.join(map(str, (ROOT, HERE.parent, HERE)))
    done = subprocess.run(
        [sys.executable, str(HERE / "killed_runs.py"), str(folder), *jobs],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": places, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr[-5000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert isinstance(found, list)
    return found


def test_a_few_kills(tmp_path: Path) -> None:
    """And two runs at once, in one process, since importing torch takes most of the time."""
    jobs = ("overwriting:steps:0", "predict:random:5", "predict:beside:2", "train:random:3")
    overwriting, predict, beside, train = happened(tmp_path, *jobs)
    assert overwriting["kills"] > 20
    assert predict["kills"] >= 5
    assert beside["pairs"] == 2
    assert train["kills"] >= 3


@pytest.mark.slow
@pytest.mark.parametrize("job", ["predict", "uncertainty", "train"])
def test_fifty_kills(tmp_path: Path, job: str) -> None:
    (found,) = happened(tmp_path, f"{job}:random:50")
    assert found["kills"] >= 50


@pytest.mark.slow
@pytest.mark.parametrize("job", ["predict", "uncertainty", "train"])
def test_kills_at_every_step(tmp_path: Path, job: str) -> None:
    (found,) = happened(tmp_path, f"{job}:steps:0")
    assert found["kills"] > 30
    # Some of the steps are between opening a file and giving it its name.
    assert found["unfinished"] > 5


@pytest.mark.slow
def test_many_pairs_of_runs(tmp_path: Path) -> None:
    jobs = ("predict:beside:20", "uncertainty:beside:10")
    assert [found["pairs"] for found in happened(tmp_path, *jobs)] == [20, 10]


@pytest.mark.slow
@pytest.mark.parametrize("moments", ["group", "parent"])
def test_kills_with_two_jobs(tmp_path: Path, moments: str) -> None:
    """Workers that outlive their run end the scans that they were at, and nothing else."""
    (found,) = happened(tmp_path, f"predict --jobs 2:{moments}:5")
    assert found["kills"] >= 5
