# SPDX-License-Identifier: MIT
"""The examples run and print their results."""

import ast
import importlib
import json
import re
import runpy
import sys
import tomllib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import plyfile
import pytest
from evaluation_runs import CAR, ROAD, World
from scans import make_scan, salsanext_of, write_array, write_bin, write_sequence, write_weights
from shallow_network import SHALLOW

from salsanext_cli import Scan, label_space, read_labels, write_labels
from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.network.registry import ARCHITECTURES
from salsanext_cli.core.network.salsanext import SalsaNext
from salsanext_cli.io.files.json_files import encode_json
from salsanext_cli.io.poses import encode_poses
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.runs.drives.drive_record import drive_record
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.training.run_folder import write_log

EXAMPLES = Path(__file__).parents[1] / "examples"


def load(name: str) -> Callable[..., None]:
    """Return the function `main` of an example, which is not part of any package."""
    main: Callable[..., None] = runpy.run_path(str(EXAMPLES / f"{name}.py"))["main"]
    return main


def test_imports_of_scripts_exist():
    """Only `make test-slow` runs most of the scripts."""
    for folder in ("examples", "benchmarks", "docs"):
        for path in sorted((EXAMPLES.parent / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
                if isinstance(node, ast.ImportFrom) and "salsanext_cli" in (node.module or ""):
                    module = importlib.import_module(str(node.module))
                    for name in (alias.name for alias in node.names):
                        if not hasattr(module, name):
                            importlib.import_module(f"{node.module}.{name}")


@pytest.fixture
def weights(tmp_path: Path) -> Iterator[Path]:
    """Return weights of two levels, which salsanext has as long as the test runs."""
    with salsanext_of(**SHALLOW):
        yield write_weights(tmp_path / "shallow.safetensors")


@pytest.fixture
def scan(tmp_path) -> Path:
    path = tmp_path / "my scans" / "000000.bin"
    write_bin(path, make_scan())
    return path


def test_label_one_scan(scan, weights, capsys):
    load("label_one_scan")(str(scan), str(weights))
    counts = [int(line.split()[0]) for line in capsys.readouterr().out.splitlines()]
    labels = read_labels(scan.with_suffix(".label"), 1500)
    assert sorted(np.unique(labels, return_counts=True)[1], reverse=True) == counts
    assert sum(counts) == 1500


def test_own_sensor(scan, weights, tmp_path, capsys):
    out = tmp_path / "out"
    load("own_sensor")(str(scan.parent), str(out), str(weights))
    fitted = tomllib.loads((out / "mine.toml").read_text("utf-8"))
    assert (fitted["height"], fitted["width"]) == (32, 512)
    assert fitted["fov_up"] == pytest.approx(3, abs=0.2)
    assert fitted["fov_down"] == pytest.approx(-25, abs=0.2)
    assert len(read_labels(output_path(out, "my scans", "predictions", "000000"))) == 1500
    assert "1 done, 0 done already" in capsys.readouterr().out


def test_parallel_sequences(tmp_path, weights, capsys):
    for name in ("00", "01"):
        write_sequence(tmp_path / "data" / "sequences" / name, labels=False)
    places = (tmp_path / "data", tmp_path / "out", weights)
    load("parallel_sequences")(*map(str, places), "sequential")
    assert capsys.readouterr().out.splitlines() == ["00: 1 done, 0 failed", "01: 1 done, 0 failed"]
    assert output_path(tmp_path / "out", "01", "predictions", "000000").exists()


def test_draw_projection(scan, tmp_path, capsys):
    picture = tmp_path / "range.png"
    load("draw_projection")(str(scan), str(picture), "hdl64-512")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "64×512 pixels hold a point" in capsys.readouterr().out


def test_most_uncertain(tmp_path, capsys):
    for stem, value in (("calm", 0.01), ("wild", 0.2), ("middling", 0.1)):
        path = output_path(tmp_path, "08", "uncertainty/epistemic", stem)
        write_array(path, np.array([value, value, np.nan], np.float32))
    load("most_uncertain")(str(tmp_path), "2")
    assert capsys.readouterr().out.split() == ["0.200000", "08/wild", "0.100000", "08/middling"]
    with pytest.raises(SystemExit):
        load("most_uncertain")(str(tmp_path / "other"))


@pytest.mark.slow
def test_uncertainty_figures(scan, weights, tmp_path, capsys):
    folder = tmp_path / "figures"
    load("uncertainty_figures")(str(scan), str(folder), "12", "12", str(weights))
    ranks = [float(rank) for rank in re.findall(r"correlation (.+?),", capsys.readouterr().out)]
    assert all(0 < rank <= 1 for rank in ranks)
    assert ranks[2] < ranks[5], "more passes rank more like many"
    assert (folder / "uncertainty.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_ablation(tmp_path, capsys, monkeypatch):
    narrow = partial(SalsaNext, context_width=4, widths=5 * (4,), decoder_widths=4 * (4,))
    for name in ("salsanet", "salsanext"):
        monkeypatch.setitem(ARCHITECTURES, name, narrow)
    for name in ("00", "08"):
        write_sequence(tmp_path / "data" / "sequences" / name, count=600)
    arguments = (str(tmp_path / "data"), str(tmp_path / "ladder"), "2", "street")
    load("ablation")(*arguments, "SalsaNet", "+ Lovász-Softmax")
    _, _, first, last = capsys.readouterr().out.splitlines()
    assert re.match(r"\| SalsaNet \| \d+\.\d \(43.5\) \| \d+\.\d \(44.8\) \| \d", first)
    assert re.match(r"\| \+ Lovász-Softmax \| \d+\.\d \(56.6\)", last)
    plain, best = (
        read_card(tmp_path / f"ladder/{name}/last.safetensors").recipe
        for name in ("salsanet", "salsanext")
    )
    differing = {"lovasz": 1, "architecture": "salsanext"}
    assert best == plain | differing, "all rungs are trained alike"


def test_training_curves(tmp_path, capsys):
    for name, seconds in (("slow", 90), ("fast", 30)):
        rows = [{"epoch": epoch, "seconds": seconds} for epoch in (1, 2, 3)]
        rows[1]["miou"], rows[2]["miou"] = 0.25, 0.5
        (tmp_path / name).mkdir()
        write_log(tmp_path / name / "log.csv", rows)
    picture = tmp_path / "curve.png"
    load("training_curves")(str(picture), str(tmp_path / "slow"), str(tmp_path / "fast"))
    slow, fast = capsys.readouterr().out.splitlines()
    assert slow.endswith("slow: 0.0 % within 1.5 minutes")
    assert fast.endswith("fast: 50.0 % within 1.5 minutes")
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_few_labels(tmp_path, weights, capsys):
    plan = tmp_path / "plan.toml"
    few = ("folds = 2", "epochs = 1", "batch = 2", "samples_per_epoch = 2", "crop_width = 32")
    plan.write_text("\n".join((*few, 'sensors = "fitted"', 'optimiser = "adamw"')))
    load("few_labels")(str(tmp_path / "out"), "2", "4", str(plan), str(weights))
    lines = dict(line.split(" ", 1) for line in capsys.readouterr().out.splitlines())
    assert list(lines) == ["picked", "estimated", "before", "after"]
    picked = {path.stem for path in (tmp_path / "out/to-label").glob("sequences/*/velodyne/*")}
    assert picked == set(lines["picked"].split(", "))
    # The last quarter of the drive is held out.
    assert picked <= {"000000", "000001", "000002"}
    assert lines["before"] != lines["after"]


def test_label_array(tmp_path, monkeypatch, capsys, weights, take_by_default):
    take_by_default(weights)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    write_bin(Path("000000.bin"), make_scan())
    notebook = json.loads((EXAMPLES / "label_array.ipynb").read_text("utf-8"))
    cells = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert not any(cell.get("outputs") for cell in notebook["cells"])
    badge = re.search(r"colab-badge.svg\)\]\((.*?)\)", "".join(notebook["cells"][0]["source"]))
    opened = badge[1].partition(
        "https://colab.research.google.com/github/salsanext/salsanext/blob/main/"
    )
    assert (EXAMPLES.parent / opened[2]).samefile(EXAMPLES / "label_array.ipynb")
    names: dict[str, Any] = {}
    for number, body in enumerate(cells):
        exec(compile(body, f"cell {number}", "exec"), names)
    assert sum(int(line.split()[0]) for line in capsys.readouterr().out.splitlines()) == 1500
    assert names["figure"].axes[0].collections[0].get_offsets().shape == (1500, 2)


def test_rerun_recording(tmp_path, monkeypatch):
    """Without rerun-sdk, which is large: a stand-in lists the logged entities."""
    world, logged = World(tmp_path), []
    world.add("000000", [CAR, ROAD], [CAR, CAR])
    world.put("uncertainty/entropy", "000000", [0.5, 1.5])
    monkeypatch.setenv("SALSANEXT_DATASET", str(world.dataset))
    rerun = MagicMock(log=lambda entity, *_, **__: logged.append(entity))
    monkeypatch.setitem(sys.modules, "rerun", rerun)
    load("rerun_recording")(str(world.out), "drive.rrd")
    assert [*dict.fromkeys(logged)] == ["/", "name", "label", "uncertainty/entropy"]


def ray_cast(x, walls):
    """Return points that rays of an HDL-64 from (x, 0) hit of walls, and their labels.

    Each wall is at y, from one x to another, 3 m high around the sensor.
    """
    azimuth = (np.arange(1024) + 0.5) / 1024 * 2 * np.pi - np.pi
    elevation = np.radians(3 - 28 * (np.arange(10) + 0.5) / 32)
    elevation, azimuth = (angles.ravel() for angles in np.meshgrid(elevation, azimuth))
    nearest, labels = np.full(len(azimuth), np.inf), np.zeros(len(azimuth), np.uint32)
    for y, start, end, label in walls:
        distance = y / np.sin(azimuth)
        place = x + distance * np.cos(azimuth)
        hit = (distance > 0) & (distance < np.minimum(nearest, 40)) & (place >= start)
        hit &= place <= end
        nearest[hit], labels[hit] = distance[hit], label
    seen = np.isfinite(nearest)
    points = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], 1) * nearest[:, None]
    return points[seen].astype(np.float32), labels[seen]


ORIGIN = np.array([4e5, 5e6, 30.0])
BUILDING = 50


@pytest.fixture
def drive(tmp_path):
    """Fuse four scans of a parked and a moving car between two walls, by hand; the last is apart.

    Return the folder of the results, and every place on the walls, with its range, in the others.
    """
    poses, places = np.tile(np.eye(4), (4, 1, 1)), []
    fused = tmp_path / "fused/sequences/08"
    walls = (10.0, -30, 30, BUILDING), (-10.0, -30, 30, BUILDING)
    for i, pose in enumerate(poses):
        pose[:3, 3] = ORIGIN + [i, 0, 0]
        cars = (5.0, 0, 4, CAR), (-5.0, 4 * i - 6, 4 * i - 4, CAR)
        points, labels = ray_cast(i, (*cars, *walls))
        labels[::50] = 0
        write_bin(tmp_path / f"08/velodyne/{i}.bin", Scan(points, np.zeros(len(points), "f4")))
        write_labels(fused / f"predictions/{i}.label", labels | 7 << 16)
        if i < 3:
            on_walls = points[labels == BUILDING]
            places += [(point + pose[:3, 3], np.linalg.norm(point)) for point in on_walls]
    record = drive_record(Drive(poses, np.array([0, 0, 0, 1])), [*"0123"])
    (fused / "drive.json").write_bytes(encode_json(record))
    (fused / "poses.txt").write_bytes(encode_poses(poses))
    return fused, places


def test_drive_map(drive, tmp_path, capsys):
    fused, places = drive
    nearest: dict[tuple[int, ...], float] = {}
    for place, distance in places:
        voxel = tuple(np.floor(place / 0.5).astype(int))
        nearest[voxel] = min(nearest.get(voxel, np.inf), distance)
    draw = load("drive_map")
    draw(fused, tmp_path / "08", tmp_path / "map.ply", 0.5, "semantic-kitti")
    printed = capsys.readouterr()
    assert "3 of 4 scans" in printed.err
    assert f"{len(nearest)} points of 3 scans" in printed.out
    vertices = plyfile.PlyData.read(tmp_path / "map.ply")["vertex"]
    found = np.stack([vertices[axis] for axis in "xyz"], axis=1)
    voxels = map(tuple, np.floor(found / 0.5).astype(int))
    assert dict(zip(voxels, vertices["range"], strict=True)) == pytest.approx(nearest)
    assert np.abs(np.abs(found[:, 1] - ORIGIN[1]) - 10).max() < 1e-4
    assert set(vertices["label"]) == {BUILDING}
    rgb = np.stack([vertices[name] for name in ("red", "green", "blue")], axis=1)
    space = label_space()
    assert (rgb == space.colours[space.names.index("building")]).all()
    for change in (
        {"size": 0.0},
        {"target": tmp_path / "map.ply"},
        {"target": tmp_path / "map.pcd"},
        {"fused": tmp_path},
        {"scans": tmp_path / "fused"},
    ):
        given = {"fused": fused, "scans": tmp_path / "08", "target": tmp_path / "new.ply"}
        with pytest.raises((SystemExit, SalsanextError)):
            draw(**{**given, "size": 0.5, "classes": "semantic-kitti", **change})
    edited = (fused / "poses.txt").read_text().replace("4.00001", "4.00002")
    for line in ("", "1 0 0\n", "1 0 0 0 0 1 0 0 0 0 1 0\n", edited):
        whole = (fused / "poses.txt").read_bytes()
        (fused / "poses.txt").write_text(line)
        with pytest.raises(SalsanextError):
            draw(fused, tmp_path / "08", tmp_path / "new.ply", 0.5, "semantic-kitti")
        (fused / "poses.txt").write_bytes(whole)
    assert not (tmp_path / "new.ply").exists()
    (fused / "predictions/1.label").unlink()
    with pytest.raises(SystemExit, match=r"missing for 1 of the scans: 1 "):
        draw(fused, tmp_path / "08", tmp_path / "new.ply", 0.5, "semantic-kitti")


def test_every_example_has_a_command_line_and_a_test():
    for path in EXAMPLES.glob("*.py"):
        assert f"\nRun: python examples/{path.name} " in path.read_text("utf-8")
        assert f"test_{path.stem}" in globals()
