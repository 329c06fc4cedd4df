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


def killed(job: str, moments: str, kills: int, folder: Path) -> dict[str, Any]:
    """Return what happened to a job that was killed so often."""
    places = os.pathsep.join(map(str, (ROOT, HERE.parent, HERE)))
    done = subprocess.run(
        [sys.executable, str(HERE / "killed_runs.py"), job, moments, str(kills), str(folder)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": places, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr[-5000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert isinstance(found, dict)
    return found


@pytest.mark.parametrize(("job", "kills"), [("predict", 5), ("train", 3)])
def test_a_few_kills(tmp_path: Path, job: str, kills: int) -> None:
    assert killed(job, "random", kills, tmp_path)["kills"] >= kills


def test_kills_at_every_step_of_replacing_results(tmp_path: Path) -> None:
    found = killed("overwriting", "steps", 0, tmp_path)
    assert found["kills"] > 20


@pytest.mark.slow
@pytest.mark.parametrize("job", ["predict", "uncertainty", "train"])
def test_fifty_kills(tmp_path: Path, job: str) -> None:
    found = killed(job, "random", 50, tmp_path)
    assert found["kills"] >= 50


@pytest.mark.slow
@pytest.mark.parametrize("job", ["predict", "uncertainty", "train"])
def test_kills_at_every_step(tmp_path: Path, job: str) -> None:
    found = killed(job, "steps", 0, tmp_path)
    assert found["kills"] > 30
    # Some of the steps are between opening a file and giving it its name.
    assert found["unfinished"] > 5


@pytest.mark.slow
@pytest.mark.parametrize("moments", ["group", "parent"])
def test_kills_with_two_jobs(tmp_path: Path, moments: str) -> None:
    """Workers that outlive their run end the scans that they were at, and nothing else."""
    found = killed("predict --jobs 2", moments, 5, tmp_path)
    assert found["kills"] >= 5
