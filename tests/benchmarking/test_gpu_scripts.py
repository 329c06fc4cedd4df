# SPDX-License-Identifier: MIT
"""Scripts of a run on a GPU: packed scans, ray casting, and all parts of the run."""

import json
import math

import numpy as np
import pytest
from scans import SMALL, write_bin, write_sequence

from benchmarks.gpu import gpu_run
from benchmarks.gpu.gpu_train_data import source_of
from benchmarks.weights import pack
from benchmarks.weights.default_weights import LABEL_SPACES, simulated_scans
from benchmarks.weights.ray_casting import RayScene
from salsanext_cli import read_labels, read_scan
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.synthesis.mesh import Mesh, Skin
from salsanext_cli.synthesis.presets import Material

# Packed scans


def test_packed_scans_come_back_as_fine_as_they_are_stored(tmp_path):
    """Halves of a step of 1/128 m and of 1/255; points that have no place in int16 are dropped."""
    for name, seed in (("one", 0), ("two", 5)):
        write_sequence(tmp_path / name / "sequences/00", ["a", "b"], count=700, seed=seed)
    far = tmp_path / "two/sequences/00/velodyne/b.bin"
    scan = read_scan(far)
    scan.points[:4] = [[300, 0, 0], [0, -256, 0], [0, 0, math.nan], [-254.9, 254.9, 0]]
    write_bin(far, scan)
    pack.main(*map(str, (tmp_path / "one", tmp_path / "two", tmp_path / "p.npz")))
    roots = pack.unpack(tmp_path / "p.npz", tmp_path / "back")
    assert [root.name for root in roots] == ["one", "two"]
    for root in roots:
        before, after = find_scans(tmp_path / root.name), find_scans(root)
        assert [file.name for file in before] == [file.name for file in after]
        for old, new in zip(before, after, strict=True):
            kept = slice(3 if old.path == far else 0, None)
            one, other = read_scan(old.path), read_scan(new.path)
            np.testing.assert_allclose(other.points, one.points[kept], atol=0.5 / 128 + 1e-6)
            np.testing.assert_allclose(other.intensity, one.intensity[kept], atol=0.5 / 255 + 1e-6)
            labels = read_labels(old.label_path)[kept]
            np.testing.assert_array_equal(read_labels(new.label_path), labels)
            stored = other.points.astype(np.float64) * 128
            np.testing.assert_array_equal(stored, np.rint(stored))


# Ray casting


def triangles(count: int, seed: int = 0) -> Mesh:
    """Return triangles of very different sizes; some have no area, some are the same."""
    random = np.random.default_rng(seed)
    centres = random.uniform(-20, 20, (count, 1, 3))
    shapes, sizes = random.normal(size=(count, 3, 3)), random.choice([0.1, 1, 8], (count, 1, 1))
    vertices = centres + shapes * sizes
    vertices[: count // 10, 2] = vertices[: count // 10, 1]
    vertices[-count // 10 :] = vertices[-1]
    skin = Skin(40, Material.ASPHALT)
    return Mesh.uniform(vertices.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), skin)


def nearest_hit(ray: np.ndarray, corners: np.ndarray) -> tuple[float, int]:
    """Return distance and triangle of the nearest hit; solves for coordinates in each triangle."""
    nearest = math.inf, -1
    for number, (a, b, c) in enumerate(corners):
        system = np.stack([b - a, c - a, -ray[3:]], axis=1)
        if abs(np.linalg.det(system)) < 1e-12:
            continue
        u, v, distance = np.linalg.solve(system, ray[:3] - a)
        if u >= 0 and v >= 0 and u + v <= 1 and 0 < distance < nearest[0]:
            nearest = distance, number
    return nearest


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 4, 5, 300])
def test_rays_hit_the_nearest_triangle(count):
    mesh, random = triangles(count), np.random.default_rng(1)
    directions = random.normal(size=(150, 3))
    directions[:6] = [*np.eye(3), *-np.eye(3)]  # Parallel to the sides of all boxes
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rays = np.concatenate([random.uniform(-15, 15, (150, 3)), directions], axis=1)
    found, triangle, cosine = RayScene(mesh).cast(rays)
    corners = mesh.vertices.astype(np.float32).astype(np.float64)[mesh.triangles]
    expected = [nearest_hit(ray, corners) for ray in rays]
    distance = np.array([each[0] for each in expected])
    np.testing.assert_allclose(found, distance, rtol=1e-5)
    hit = np.isfinite(distance)
    found = corners[triangle[hit].astype(int)]
    np.testing.assert_array_equal(found, corners[[each[1] for each in expected if each[1] >= 0]])
    a, b, c = found.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(cosine[hit], abs((normal * rays[hit, 3:]).sum(1)), atol=1e-5)
    assert not cosine[~hit].any()


# The run


@pytest.mark.parametrize("name", LABEL_SPACES)
def test_scans_of_every_packed_data_set_have_a_label_space(name):
    source = source_of([], name, SMALL)
    assert source.space.names
    assert source.sensor == SMALL


@pytest.mark.slow
def test_a_part_that_fails_does_not_stop_the_others(tmp_path, capsys):
    words = (str(tmp_path / "out"), "--parts", "speed,train", "--device", "cpu")
    assert gpu_run.main(*words, "--weights", str(tmp_path / "none.safetensors")) == 1
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert [part["status"] for part in report["parts"].values()] == [1, 1]
    assert report["machine"]["device"] == "cpu"
    log = (tmp_path / "out/run.log").read_text()
    assert log.count("in work") == 2
    assert "none.safetensors" in log
    assert capsys.readouterr().out == log


@pytest.mark.slow
@pytest.mark.long
def test_every_part_runs_on_a_cpu(tmp_path):
    stems = [f"{i:06}" for i in range(12)]
    for sequence in ("pandaset/sequences/00", "aachen/sequences/a0", "aachen/sequences/a1"):
        write_sequence(tmp_path / sequence, stems, count=2000)
    pack.pack([tmp_path / "pandaset", tmp_path / "aachen"], tmp_path / "p.npz")
    out = tmp_path / "out"
    words = ("--device", "cpu", "--minutes", "30", "--small", "--pack", str(tmp_path / "p.npz"))
    assert gpu_run.main(str(out), *words) == 0, (out / "run.log").read_text()
    names = {"run.log", "report.json", "log.csv", "scores.json", "class_counts.json"}
    names |= {"last.safetensors", "module.safetensors"}
    assert {path.name for path in out.iterdir()} == names
    report = json.loads((out / "report.json").read_text())
    figures = {
        part: {row["name"]: row["value"] for row in found["figures"]}
        for part, found in report["parts"].items()
    }
    assert [*figures] == ["tests", "speed", "training", "train"]
    assert "passed" in figures["tests"]["tests"]
    assert figures["speed"]["16×64 network, times as fast"] > 0
    assert figures["speed"]["16×64 predict, --batch auto --jobs auto, the later scans"] > 0
    assert figures["speed"]["16×64 sn.label of a scan in memory"] > 0
    assert figures["training"]["store of 4 of 4 scans, batches"] > 0
    assert figures["training"]["step on the device, width 64, batch 2"] > 0
    assert figures["train"]["steps"] > 0
    assert simulated_scans(out) > 0
    assert figures["train"]["learning rate at the end"] < 1e-5
    scores = json.loads((out / "scores.json").read_text())["scores"]
    assert scores.keys() == {"validation", "pandaset"}
    card = read_card(out / "last.safetensors")
    assert "and real scans" in card.description
    assert card.sensor.width == 64
