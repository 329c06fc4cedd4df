# SPDX-License-Identifier: MIT
"""Every stage on a disk that is full: one line, no half file, and room lets it finish."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import which

import pytest
from scans import SMALL, files_below, write_sequence, write_weights
from tiny_network import TinyNetwork

from salsanext_cli.cli import options
from salsanext_cli.network.registry import ARCHITECTURES

STAGES = {
    "project": ("project {data} {out} --sensor {sensor}", ()),
    "predict": ("predict {data} {out} --weights {weights} --probabilities", ()),
    "uncertainty": (
        "uncertainty {data} {out} --weights {weights} --samples 2 --aleatoric none",
        (),
    ),
    "export-ply": ("export-ply --out {out} --colour label", ("predict",)),
    "picture": ("picture {out} --colour label --limit 1", ("predict",)),
    "eval": ("eval --out {out}", ("predict",)),
}
"""Command lines, and the stages that come before each."""
COUNT = 20_000
"""Points of a scan, so that one result of any stage needs more room than some records."""
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
def places(tmp_path: Path) -> dict[str, Path]:
    """Return scans, weights and a sensor on a disk that has room."""
    write_sequence(tmp_path / "data/sequences/08", ["000000"], count=COUNT)
    sensor = tmp_path / "small.toml"
    sensor.write_text("fov_up = 3.0\nfov_down = -25.0\nheight = 16\nwidth = 2048\n")
    weights = write_weights(tmp_path / "w.safetensors", sensor=SMALL)
    return {"data": tmp_path / "data", "weights": weights, "sensor": sensor}


def require_one_line(result, out: Path, before: dict[str, bytes]) -> None:
    """Fail unless a command said in one line each what could not be written."""
    assert result.exit_code == 1, result.output
    assert "Traceback" not in result.output
    errors = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert errors
    assert len(errors) <= 2, errors
    for error in errors:
        assert str(out) in error
        assert "no space left on device" in error
        assert "free some space or choose another output folder" in error
    assert not [name for name in files_below(out) if Path(name).name.startswith(".")]
    assert files_below(out).items() >= before.items()


@pytest.mark.parametrize(
    ("stage", "room"),
    [
        ("predict", 0),
        *(pytest.param(stage, 40_000, marks=pytest.mark.slow) for stage in STAGES),
    ],
)
def test_a_full_disk(run, places, disk, tmp_path, stage, room) -> None:
    _, earlier = STAGES[stage]

    def go(stage: str, out: Path):
        return run(*(word.format(**places, out=out) for word in STAGES[stage][0].split()))

    whole, out = tmp_path / "whole", disk / "out"
    for needed in (*earlier, stage):
        assert go(needed, whole).exit_code == 0
    out.mkdir()
    for needed in earlier:
        assert go(needed, out).exit_code == 0
    before = files_below(out)
    with filled(disk, room):
        require_one_line(go(stage, out), out, before)
    again = go(stage, out)
    assert again.exit_code == 0, again.output
    assert files_below(out) == files_below(whole)


@pytest.mark.parametrize("room", [pytest.param(0, marks=pytest.mark.slow), 20_000])
def test_a_training_on_a_full_disk(run, disk, tmp_path, monkeypatch, room) -> None:
    monkeypatch.setitem(ARCHITECTURES, "salsanext", TinyNetwork)
    monkeypatch.setattr(options, "sensor", lambda name: SMALL)
    for sequence in ("00", "08"):
        write_sequence(tmp_path / f"data/sequences/{sequence}", ["0", "1"], count=300)
    given = ("--recipe", "quick", "--sensor", "small", "--epochs", 1, "--set", "batch=1")

    def go(folder: Path):
        return run("train", tmp_path / "data", folder, *given)

    assert go(tmp_path / "whole").exit_code == 0
    (disk / "run").mkdir()
    with filled(disk, room):
        require_one_line(go(disk / "run"), disk / "run", {})
    assert go(disk / "run").exit_code == 0
    for name in ("last.safetensors", "best.safetensors", "curve.png"):
        assert (disk / "run" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    shutil.rmtree(disk / "run")
