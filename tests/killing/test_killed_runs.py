# SPDX-License-Identifier: MIT
"""Runs that are killed at their steps, and begun again, lose nothing; see `killed_runs`."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import salsanext_cli

HERE = Path(__file__).parent
ROOT = Path(salsanext_cli.__file__).parents[1]

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")


def kills(folder: Path, *jobs: str) -> list[int]:
    """Return how many kills the jobs of `killed_runs` survived."""
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
    """In one process, since importing torch takes most of the time."""
    overwriting, training = kills(tmp_path, "overwriting:20", "training:40")
    assert overwriting >= 2
    assert training >= 1


@pytest.mark.slow
@pytest.mark.parametrize("job", ["overwriting", "training"])
def test_kills_at_every_step(tmp_path: Path, job: str) -> None:
    (found,) = kills(tmp_path, f"{job}:1")
    assert found > 30
