# SPDX-License-Identifier: MIT
"""The benchmarks run and print what they say; how fast they are is not tested."""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from scans import make_scan, write_sequence

from salsanext_cli.sensors import Sensor
from salsanext_cli.stages.inspect import write_sensor
from salsanext_cli.storage.point_files import write_bin

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def test_uncertainty_cost(tmp_path, weights, capsys):
    write_bin(tmp_path / "000000.bin", make_scan())
    tiny = Sensor("tiny", 3.0, -25.0, 16, 64, range_noise=0.02, intensity_noise=0.02)
    write_sensor(tmp_path / "tiny.toml", tiny)
    main = runpy.run_path(str(BENCHMARKS / "uncertainty_cost.py"))["main"]
    main(str(tmp_path / "000000.bin"), str(tmp_path / "tiny.toml"), "2", "2", str(weights))
    lines = capsys.readouterr().out.splitlines()
    assert [line[:32].strip() for line in lines] == [
        "one deterministic pass",
        "2 passes of dropout",
        "assumed density filtering",
        "analytic, one pass",
        "dropout and density filtering",
    ]
    assert "1.0 × (1.0 to 1.0)" in lines[0]
    assert all(" s " in line for line in lines)


def test_training_speed(tmp_path):
    """Both sides find the same loss, or it would stop."""
    write_sequence(tmp_path / "sequences/00", ["0", "1"])
    write_sensor(tmp_path / "tiny.toml", Sensor("tiny", 3.0, -25.0, 16, 64))
    options = ("--sensor", tmp_path / "tiny.toml", "--architecture", "salsanet", "--turns", "2")
    script = str(BENCHMARKS / "training_speed.py")
    done = subprocess.run(
        [sys.executable, script, str(tmp_path), *map(str, options)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(BENCHMARKS.parent)},
    )
    _, losses, _, *parts, ratio = done.stdout.splitlines()
    plain, ours = (float(each) for each in re.findall(r"\d+\.\d+", losses))
    assert plain == pytest.approx(ours, rel=1e-4)
    names = [line.split()[0] for line in parts]
    assert names == ["data", "forward", "loss", "backward", "update", "book-keeping", "step"]
    assert re.fullmatch(r"ours is \S+ × as fast \(\S+ to \S+ over 2 turns\)", ratio)


def test_stage_cost(tmp_path, weights, capsys):
    if not Path("/proc/self/io").exists():
        pytest.skip("Linux only")
    write_sequence(tmp_path / "sequences/08", ["000000", "000001"])
    main = runpy.run_path(str(BENCHMARKS / "stage_cost.py"))["main"]
    main(str(tmp_path), str(tmp_path / "out"), "2", str(weights))
    lines = capsys.readouterr().out.splitlines()
    found = {line[:24].strip(): re.findall(r"(\d+\.\d+) MB", line) for line in lines}
    stages = ["project", "predict, range images", "knn-refine", "predict, scans", "eval"]
    assert list(found) == [*stages, "export-ply", "uncertainty, 2 passes"]
    # 1500 points of 16 bytes; 5 float32 channels of 16×128 pixels and 1500 int32; 1500 uint32.
    for stage, read, written in (("project", 0.024, 0.047), ("predict, scans", 0.024, 0.006)):
        numbers = [float(number) for number in found[stage]]
        assert numbers == pytest.approx([read, written], abs=0.011)


def test_many_scans(tmp_path, capsys):
    main = runpy.run_path(str(BENCHMARKS / "many_scans.py"))["main"]
    main(str(tmp_path), "40", "threading")
    lines = capsys.readouterr().out.splitlines()
    steps = ["find scans", "claim", "claim again", "divide into shards", "skip what is done"]
    assert [line[:24].strip() for line in lines] == [*steps, "chunks, threading"]
    assert not list(tmp_path.iterdir())
