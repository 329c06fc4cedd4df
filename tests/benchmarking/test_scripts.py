# SPDX-License-Identifier: MIT
"""The scripts of benchmarks/ run and print what they say; no test says how fast anything is."""

import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scans import write_sequence

from salsanext_cli import Scan, label_space, project, read_labels, read_scan, sensor, write_labels
from salsanext_cli.formats.kitti import write_bin
from salsanext_cli.training.data.other_sensors import HOLE_SHARES, hole_cells

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
TINY = "fov_up = 3.0\nfov_down = -25.0\nheight = 16\nwidth = 64\n"
CHECK_RATIOS = ("checks, elapsed", "checks, CPU")
NOISE = "range_noise = 0.02\nintensity_noise = 0.02\n"


@pytest.fixture
def data(tmp_path):
    """Return a data set of two scans with a sensor beside it."""
    write_sequence(tmp_path / "sequences/00", ["0", "1"])
    (tmp_path / "tiny.toml").write_text(TINY + NOISE)
    return tmp_path


def printed(capsys, script: str, *words: object) -> dict[str, str]:
    """Run a script; return the rest of each line by its name."""
    runpy.run_path(str(BENCHMARKS / script))["main"](*map(str, words))
    lines = capsys.readouterr().out.splitlines()
    return dict(re.split(r" {2,}", line, maxsplit=1) for line in lines)


@pytest.mark.slow
def test_uncertainty_cost(data, weights, capsys):
    scan = data / "sequences/00/velodyne/0.bin"
    found = printed(capsys, "uncertainty_cost.py", scan, data / "tiny.toml", 2, 2, weights)
    assert list(found) == [
        *("one deterministic pass", "2 passes of dropout", "assumed density filtering"),
        *("eight noisy copies", "analytic, one pass", "dropout and noisy copies"),
    ]
    assert "1.0 × (1.0 to 1.0)" in found["one deterministic pass"]


def script_printed(script: str, *words: object, **environment: str) -> list[str]:
    """Run a script in a process of its own; return its lines."""
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / script), *map(str, words)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(BENCHMARKS.parent), **environment},
    )
    return done.stdout.splitlines()


@pytest.mark.slow
def test_engines(data, weights):
    scan, one_thread = data / "sequences/00/velodyne/0.bin", {"NUMBA_NUM_THREADS": "1"}
    given = (scan, "--rounds", 1, "--weights", weights, "--sensors", data / "tiny.toml")
    title, *rows = script_printed("engines.py", *given, **one_thread)
    assert title.startswith("16×64, 1 threads")
    found = {row[:42].rstrip(): row[42:] for row in rows}
    assert "1.00 × (1.00 to 1.00)  100.00%" in found["eager float32"]
    assert found.keys() >= {"channels last float32", "OpenVINO float32"}
    for name, row in found.items():
        same = float(row.rpartition(" ")[2].rstrip("%"))
        assert same > (99.9 if "float32" in name else 50), name


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/io").exists(), reason="Linux only")
def test_stage_cost(data, weights, capsys):
    found = printed(capsys, "stage_cost.py", data, data / "out", 2, weights)
    stages = ["project", "predict, range images", "knn-refine", "predict, scans", "eval"]
    assert list(found) == [*stages, "export-ply", "uncertainty, 2 passes"]
    # 1500 points of 16 bytes; 5 float32 channels of 16×128 pixels and 1500 int32; 1500 uint32.
    for stage, read, written in (("project", 0.024, 0.047), ("predict, scans", 0.024, 0.006)):
        numbers = [float(number) for number in re.findall(r"(\d+\.\d+) MB", found[stage])]
        # `predict` reads ahead: of two scans, both before the first has its results.
        ahead = read if stage == "predict, scans" else 0
        assert numbers == pytest.approx([read - ahead, written], abs=0.011)


def test_checks_cost(data, weights, capsys):
    found = printed(capsys, "checks_cost.py", data, 2, weights)
    assert list(found) == ["with checks", "without", *CHECK_RATIOS, "fit, once a run"]
    for name in CHECK_RATIOS:
        assert re.fullmatch(r"\d+\.\d{3} × \(\d+\.\d{3} to \d+\.\d{3}\)", found[name])
    assert found["fit, once a run"].endswith("of 2 scans")
    assert found["without"].endswith(" ms of CPU")


def test_many_scans(tmp_path, capsys):
    found = printed(capsys, "many_scans.py", tmp_path, 40, "threading")
    steps = ["find scans", "record the run", "record another run", "divide into shards"]
    assert list(found) == [*steps, "skip what is done", "chunks, threading"]
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_other_sensors(tmp_path, weights, capsys):
    azimuth = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    elevation, azimuth = np.meshgrid(np.radians(np.linspace(2, -24, 64)), azimuth, indexing="ij")
    flat = np.cos(elevation)
    points = 9 * np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1)
    points = points.reshape(-1, 3).astype(np.float32)
    folder = tmp_path / "sequences/00"
    write_bin(folder / "velodyne/0.bin", Scan(points, np.zeros(len(points), np.float32)))
    write_labels(folder / "labels/0.label", np.full(len(points), 40))
    found = printed(capsys, "other_sensors.py", tmp_path, "--weights", weights, "--sensors")
    assert [name.rpartition(" ")[2] for name in found][-4:] == ["1/1", "1/2", "1/3", "1/4"]
    for line in [*found.values()][-4:]:
        assert len(re.findall(r"\d+\.\d / \d+\.\d", line)) >= 4


@pytest.mark.slow
def test_training_speed(data):
    """Both sides find the same loss, or it would stop."""
    options = ("--sensor", data / "tiny.toml", "--architecture", "salsanet", "--turns", 2)
    options += ("--precision", "float32")
    _, losses, *_, ratio = script_printed("training_speed.py", data, *options)
    plain, ours = (float(each) for each in re.findall(r"\d+\.\d+", losses))
    assert plain == pytest.approx(ours, rel=1e-4)
    assert re.fullmatch(r"ours is \S+ × as fast \(\S+ to \S+ over 2 turns\)", ratio)


def test_learning_curve(tmp_path, capsys, monkeypatch):
    """Each start and number of scans has a line, of scores on sequences that took no part."""
    for name in ("a", "b", "c"):
        write_sequence(tmp_path / "data/sequences" / name, ["0", "1"], count=300)
    monkeypatch.syspath_prepend(BENCHMARKS)
    script = runpy.run_path(str(BENCHMARKS / "learning_curve.py"))
    commands = []

    def command(words, **_):
        """Say what `eval` would; of a training remember the number of scans."""
        if words[1] == "train":
            root = Path(words[2])
            sequences = {
                name: {
                    path.name.split("-")[0] for path in root.glob(f"sequences/{name}/velodyne/*")
                }
                for name in ("train", "valid")
            }
            assert sequences["train"]
            assert not sequences["train"] & sequences["valid"]
            commands.append(len([*root.glob("sequences/train/velodyne/*.bin")]))
        scores = {"scores": {"accuracy": 0.8, "iou_mean_present": 0.4}}
        return subprocess.CompletedProcess(words, 0, json.dumps(scores).encode())

    monkeypatch.setattr(subprocess, "run", command)
    script["main"](str(tmp_path / "data"), str(tmp_path / "out"), "--counts", "1", "3")
    assert capsys.readouterr().out.splitlines() == [
        f"{way}, {count} scans  80.0 ± 0.0  40.0 ± 0.0"
        for way in ("default", "random")
        for count in (1, 3)
    ]
    assert commands == [1, 1, 1, 3, 3, 3] * 2
    assert (tmp_path / "out/curve.png").stat().st_size > 1000


def test_fusion(tmp_path, capsys, monkeypatch):
    """Poses are computed of links without poses, then those given are used; both are judged."""
    drive = write_sequence(tmp_path / "drive/00", ["0", "1"], count=300)
    for name in ("0", "1"):
        moving = np.repeat([252, 40], 150)
        write_labels(drive / f"labels/{name}.label", moving)
    (drive / "poses.txt").write_text("")
    monkeypatch.syspath_prepend(BENCHMARKS)
    script = runpy.run_path(str(BENCHMARKS / "fusion.py"))
    commands = []

    def command(words, **_):
        """Say what `eval` would; write labels as `predict` and `fuse` would."""
        commands.append(words[1])
        fused = words[1] == "fuse"
        if words[1] == "predict":
            assert not (Path(words[2]).parent / "poses.txt").exists()
        if words[1] != "eval":
            for name in ("0", "1"):
                path = Path(words[3]) / f"sequences/00/predictions/{name}.label"
                write_labels(
                    path,
                    np.repeat([10, 50 - 10 * fused], [75 * (1 + fused), 300 - 75 * (1 + fused)]),
                )
        is_fused = "single" not in str(words[2])
        iou = 0.5 + 0.1 * is_fused
        found = {
            "scores": {
                "accuracy": iou,
                "iou_mean_present": iou / 2,
                "classes": [
                    {"train_id": 1, "iou": iou - 0.3 * is_fused},
                    {"train_id": 2, "iou": None},
                ],
            },
            "confusion": [[0, 0, 0], [0, 2000, 0], [0, 0, 5]],
            "uncertainty": {"least_confidence": {"aurc": 0.2}, "disagreement": {"aurc": 0.1}},
        }
        return subprocess.CompletedProcess(words, 0, json.dumps(found).encode())

    monkeypatch.setattr(subprocess, "run", command)
    script["main"](str(tmp_path / "out"), str(drive))
    (line,) = capsys.readouterr().out.splitlines()
    assert "single 50.0 / 25.0  fused 60.0 / 30.0  AURC 0.2000 → 0.1000" in line
    assert "worst class -20.0  moving 50.0 → 100.0  computed" in line
    assert commands == ["predict", "fuse", "fuse", "eval", "eval"]


def test_holes_are_counted_as_by_a_plain_loop():
    script = runpy.run_path(str(BENCHMARKS / "hole_shares.py"))
    random = np.random.default_rng(0)
    ranges = np.where(random.random((8, 64)) < 0.3, 0, random.uniform(2, 60, (8, 64)))
    cells, kinds = hole_cells(ranges), HOLE_SHARES.shape[1]
    wanted = np.zeros((3, *HOLE_SHARES.shape), int)
    for row in range(8):
        for column in range(64):
            cell, right = cells[row, column], (column + 1) % 64
            if cell < 0:
                continue
            hole = ranges[row, column] == 0
            goes_on = hole and ranges[row, right] == 0 and cells[row, right] >= 0
            wanted[:, cell // kinds, cell % kinds] += [1, hole, goes_on]
    np.testing.assert_array_equal(script["count_holes"](ranges), wanted)


def test_hole_shares(tmp_path, capsys):
    write_sequence(tmp_path / "streets/sequences/00", ["0", "1"], count=900)
    tiny = tmp_path / "tiny.toml"
    tiny.write_text(TINY)
    scan = tmp_path / "streets/sequences/00/velodyne/0.bin"
    script = runpy.run_path(str(BENCHMARKS / "hole_shares.py"))
    script["main"](f"two={tmp_path / 'streets'}", str(scan), "--sensor", str(tiny))
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == ["two", "0", "mean"]
    columns = HOLE_SHARES.size + 4
    assert [len(line.split()) for line in lines[1:]] == [1 + columns] * 3
    assert 0 < float(lines[1].split()[1]) < 100


def test_street_statistics(tmp_path, capsys):
    script = runpy.run_path(str(BENCHMARKS / "street_statistics.py"))
    folder = write_sequence(tmp_path / "streets/sequences/00", ["0"], count=900)
    tiny = tmp_path / "tiny.toml"
    tiny.write_text(TINY)
    words = (f"simulated={tmp_path / 'streets'}", str(tmp_path / "streets"), "--sensor", str(tiny))
    script["main"](*words, "--json")
    found = json.loads(capsys.readouterr().out)
    assert [*found] == ["simulated", "streets"]
    labels = label_space().to_train(read_labels(folder / "labels/0.label"))
    ranges = project(read_scan(folder / "velodyne/0.bin"), sensor(str(tiny))).point_range
    row = found["simulated"]["car"]
    assert row["share"] == pytest.approx((labels == 1).sum() / (labels > 0).sum())
    quartiles = np.quantile(ranges[labels == 1], (0.25, 0.5, 0.75))
    assert row["range"] == pytest.approx(quartiles.tolist())
    assert row["nearer"][1] == pytest.approx((ranges[labels == 1] < 10).mean())
    assert 0 < row["columns"] < 1
    assert 0 <= row["to_top"] <= 1
    script["main"](*words)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + 2 * 19
    assert {line.count("|") for line in lines} == {11}
