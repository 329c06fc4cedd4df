# SPDX-License-Identifier: MIT
"""Stages on a full disk: an error, no partial file, and a rerun that completes."""

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import which

import pytest
from scans import SMALL, files_below, write_sequence, write_weights

STAGES = {
    "predict": ("predict {data} {out} --weights {weights} --probabilities", ()),
    "export-ply": ("export-ply {out} --colour label", ("predict",)),
    "picture": ("picture {out} --colour label --limit 1", ("predict",)),
    "eval": ("eval {out}", ("predict",)),
}
"""Command lines, and the stages that come before each."""
COUNT = 20_000
"""Points of a scan, so that a result of any stage is larger than some records."""
DISK_BYTES = 16 << 20


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """Mount a small disk in memory, or skip the test."""
    folder = tmp_path / "disk"
    folder.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(folder)]
    if not which("mount") or subprocess.run(words, capture_output=True, check=False).returncode:
        pytest.skip("may not mount a disk")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], capture_output=True, check=True)


@contextmanager
def filled(disk: Path, room: int) -> Iterator[None]:
    """Leave only so many bytes of room on a disk."""
    status = os.statvfs(disk)
    filler = disk / "filler"
    with filler.open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, status.f_bavail * status.f_frsize - room)
    try:
        yield
    finally:
        filler.unlink()


@pytest.fixture
def inputs(tmp_path: Path) -> dict[str, Path]:
    """Return scans and weights on a disk that has room."""
    write_sequence(tmp_path / "data/sequences/08", ["000000"], count=COUNT)
    weights = write_weights(tmp_path / "w.safetensors", sensor=SMALL)
    return {"data": tmp_path / "data", "weights": weights}


def require_errors(result, out: Path, before: dict[str, bytes]) -> None:
    """Fail unless a command has printed one or two errors, and has written no partial file."""
    assert result.exit_code == 1, result.output
    assert "Traceback" not in result.output
    errors = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert 1 <= len(errors) <= 2, errors
    assert all(str(out) in error for error in errors)
    assert not [name for name in files_below(out) if Path(name).name.startswith(".")]
    assert files_below(out).items() >= before.items()


@pytest.mark.drawn
@pytest.mark.parametrize(
    ("stage", "room"),
    [("predict", 0), *(pytest.param(stage, 40_000, marks=pytest.mark.slow) for stage in STAGES)],
)
def test_a_full_disk(run, inputs, disk, tmp_path, stage, room) -> None:
    _, earlier = STAGES[stage]

    def go(stage: str, out: Path):
        return run(*(word.format(**inputs, out=out) for word in STAGES[stage][0].split()))

    whole, out = tmp_path / "whole", disk / "out"
    for needed in (*earlier, stage):
        assert go(needed, whole).exit_code == 0
    out.mkdir()
    for needed in earlier:
        assert go(needed, out).exit_code == 0
    before = files_below(out)
    with filled(disk, room):
        require_errors(go(stage, out), out, before)
    again = go(stage, out)
    assert again.exit_code == 0, again.output
    assert files_below(out) == files_below(whole)
