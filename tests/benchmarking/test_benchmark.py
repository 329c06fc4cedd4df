# SPDX-License-Identifier: MIT
"""A benchmark measures what it says; no test says how fast anything is."""

import io
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import speed
import speed_turn as turn
import torch
from rich.console import Console
from scans import SMALL, make_scan, write_weights
from speed import PARTS, benchmark, benchmark_table

from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import SalsanextError, UsageError, WeightsError
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import write_bin
from salsanext_cli.network.card import read_card
from salsanext_cli.network.registry import build
from salsanext_cli.network.weights import save_weights
from salsanext_cli.sensors.sensor import sensor as find_sensor

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="benchmark needs POSIX")
MACHINE = ("processor", "instructions", "threads", "torch_version", "device", "precision")
NO_GPU = not torch.cuda.is_available()
PIXELS = SMALL.height * SMALL.width


def test_what_cannot_be_compared_is_refused(tmp_path, weights):
    write_bin(tmp_path / "1.bin", make_scan(10))
    silent = replace(SMALL, range_noise=None)
    with pytest.raises(UsageError, match="noise is not known"):
        benchmark(tmp_path, network=NetworkSettings(weights, "cpu", sensor=silent))
    certain = write_weights(tmp_path / "certain.safetensors", dropout=0.0)
    with pytest.raises(WeightsError, match=r"without dropout .* --parts"):
        benchmark(tmp_path, network=NetworkSettings(certain, "cpu"))
    salsanet, other = {"name": "salsanet", "class_count": 20}, tmp_path / "other.safetensors"
    save_weights(other, build(salsanet), replace(read_card(weights), architecture=salsanet))
    with pytest.raises(WeightsError, match="architecture salsanet"):
        benchmark(tmp_path, network=NetworkSettings(other, "cpu"))


def test_sides_take_turns_on_the_same_scan(monkeypatch, tmp_path, weights):
    """Ratios are of pairs: a machine that is slow for a round is so for both sides."""
    scans = make_scan(50), make_scan(70, 1)
    for name, scan in zip("ab", scans, strict=True):
        write_bin(tmp_path / f"{name}.bin", replace(scan, intensity=scan.intensity * 255))
    seconds = {"baseline": iter((0.2, 9.0, 0.4)), "product": iter((0.1, 3.0, 0.4))}
    asked, progress = [], []

    def take_turn(side, part, task, path):
        copy = read_scan(path)
        if part == "hardware":
            machine = dict.fromkeys(MACHINE, "[some]")
            return {"machine": machine, "operations": 105e9, "bytes": len(copy) * 1e6}
        asked.append((side, part, len(copy)))
        assert find_sensor(path.with_name("sensor.toml")).view() == SMALL.view()
        original = next(scan for scan in scans if len(scan) == len(copy))
        np.testing.assert_allclose(copy.intensity, original.intensity, rtol=1e-6)
        if part == "help":
            return {"seconds": 2.504, "peak_bytes": None}
        return {"seconds": next(seconds[side]), "peak_bytes": len(asked) * 10**9}

    monkeypatch.setattr(speed, "take_turn", take_turn)
    found = benchmark(
        tmp_path,
        network=NetworkSettings(weights, "cpu", sensor=replace(SMALL, intensity_scale=255.0)),
        parts=("knn", "help"),
        progress=lambda *counts: progress.append(counts),
    )
    assert [(side, count) for side, part, count in asked if part == "knn"] == [
        *(("product", 50), ("baseline", 50), ("baseline", 70)),
        *(("product", 70), ("product", 50), ("baseline", 50)),
    ]
    assert progress == [(n, 6) for n in range(1, 7)]
    knn, help_ = found["parts"]
    assert knn["ratio"] == pytest.approx({"median": 2.0, "lowest": 1.0, "highest": 3.0})
    assert knn["baseline"] == {"median": 0.4, "seconds": [0.2, 9.0, 0.4], "peak_bytes": 8 * 10**9}
    assert knn["share_of_ceiling"] == pytest.approx((60 * 9 + PIXELS * 5) / 70e6 / 0.4)
    assert help_["product"] == {"median": 2.504, "seconds": [2.504] * 3, "peak_bytes": None}
    stream = io.StringIO()
    Console(file=stream, width=120).print(benchmark_table(found))
    lines, text = stream.getvalue().splitlines(), " ".join(stream.getvalue().split())
    rows = [line.strip("│").split("│") for line in lines if line.startswith("│")]
    assert [[cell.strip() for cell in row] for row in rows] == [
        ["knn", "400 ms", "400 ms", "2 × (1 to 3)", "0.0%", "8.00 / 7.00"],
        ["help", "–", "2.50 s", "–", "–", "–"],
    ]
    assert "small, 16×128, [some]; 2 scans of 60 points on average" in text
    assert "105 GFLOP/s of a matrix product in [some], 0.1 GB/s of a memory copy" in text
    assert "30 passes, all alike, 1 timed" in text


def test_a_process_that_fails_or_dies_is_named(monkeypatch, tmp_path, capfd):
    task = {"weights": "none.safetensors", "device": "cpu", "threads": None}
    with pytest.raises(SalsanextError, match=r"benchmark, baseline cold · .* status 1"):
        turn.take_turn("baseline", "cold", task, tmp_path / "0.bin")
    assert "No such file" in capfd.readouterr().err
    killed = tmp_path / "killed"
    killed.write_text("#!/bin/sh\nkill -9 $$\n")
    killed.chmod(0o700)
    monkeypatch.setattr(turn, "PYTHON", killed)
    with pytest.raises(SalsanextError, match=r"benchmark, product knn · .* status -9 · .* memory"):
        turn.take_turn("product", "knn", task, Path("0.bin"))


@pytest.mark.parametrize(
    "device",
    [
        pytest.param("cpu", marks=pytest.mark.slow),
        pytest.param("cuda", marks=(pytest.mark.cuda, pytest.mark.skipif(NO_GPU, reason="no GPU"))),
    ],
)
def test_everything_is_measured(tmp_path, weights, device, capsys):
    """One round of all parts, both sides in their processes; the script prints and writes all."""
    write_bin(tmp_path / "000000.bin", make_scan())
    height, width = (64, 512) if device == "cuda" else (16, 64)
    file, seen = tmp_path / "speed.json", tmp_path / "small.toml"
    seen.write_text(replace(SMALL, height=height, width=width).to_toml())
    options = ("--weights", weights, "--device", device, "--rounds", 1, "--threads", 1)
    speed.main(*map(str, (tmp_path, *options, "--sensor", seen, "--write", file)))
    found = json.loads(file.read_text())
    assert "times as fast" in capsys.readouterr().out
    if device == "cuda":
        assert found["machine"]["device"] == torch.cuda.get_device_name()
        # A GPU moves more than a hundred gigabytes a second.
        assert found["ceiling"]["bytes"] > 1e11
    assert [part["part"] for part in found["parts"]] == list(PARTS)
    for part in found["parts"]:
        assert part["product"]["median"] > 0
        assert (part["ratio"] is None) == (part["part"] == "help")
        if part["ratio"]:
            sides = part["baseline"]["median"] / part["product"]["median"]
            assert part["ratio"]["median"] == pytest.approx(sides)
        assert 0 < (part["share_of_ceiling"] or 0.5) < 1.5
