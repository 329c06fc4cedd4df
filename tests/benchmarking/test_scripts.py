# SPDX-License-Identifier: MIT
"""The scripts of benchmarks/ compute and print what they say; no test says how fast anything is."""

import json
import re
import runpy
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from command_line import called
from scans import IN_BYTES, SMALL, make_scan, write_bin, write_sequence

from benchmarks.speed import baseline as plain
from benchmarks.speed import speed
from benchmarks.speed import speed_product as product
from benchmarks.studies.corruption_models import LEVELS
from benchmarks.weights import default_weights, hole_shares
from salsanext_cli import (
    RangeImage,
    Scan,
    label_space,
    load_network,
    project,
    read_labels,
    read_scan,
)
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.uncertainty.aleatoric import aleatoric
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.selection import data_set_label_space
from salsanext_cli.training.data.other_sensors import HOLE_SHARES, hole_cells
from salsanext_cli.training.data.sources import labelled_split

TINY = "fov_up = 3.0\nfov_down = -25.0\nheight = 16\nwidth = 64\n"
NOISE = "range_noise = 0.02\nintensity_noise = 0.02\n"
SCAN = "data/sequences/08/velodyne/0.bin"
RUNS = {
    "speed.many_scans . 40": (
        *("find scans", "record the run", "record another run", "divide into shards"),
        *("skip what is done", "chunks"),
    ),
    "weights.hole_shares two=data --sensor tiny.toml": ("two", "mean"),
    "studies.street_statistics data --sensor tiny.toml": ("| car | data", "| traffic-sign | data"),
}
"""Lines that begin with these words, in this order, by the script and its arguments."""
SLOW_RUNS = {
    "studies.corruptions data out --weights w.safetensors --corruptions crosstalk --severities 2": (
        *("clean", "crosstalk 2", "crosstalk mean"),
    ),
    "speed.checks_cost data 1 w.safetensors": (
        *("with checks", "without", "checks, elapsed", "checks, CPU", "fit, once a run"),
    ),
    f"speed.uncertainty_cost {SCAN} tiny.toml 2 2 w.safetensors": (
        *("one deterministic pass", "2 passes of dropout", "assumed density filtering"),
        *("eight noisy copies", "dropout and noisy copies"),
    ),
    f"speed.engines {SCAN} --rounds 1 --weights w.safetensors --sensors tiny.toml": (
        *("eager float32", "channels last float32", "OpenVINO float32"),
    ),
    "speed.stage_cost data out 2 w.safetensors": (
        *("project", "predict, range images", "knn-refine", "predict, scans", "eval"),
        *("export-ply", "uncertainty, 2 passes"),
    ),
    "speed.pipeline data 1 w.safetensors": ("round 0", "6 scans"),
    "speed.training_speed data --sensor tiny.toml --architecture salsanext --turns 1": (
        *("loss of the same batch", "data", "book-keeping", "step", "ours is "),
    ),
    "speed.sample_speed data --sensor tiny.toml --recipe street --turns 1": (
        *("workers ", "device ", "the code of a device is "),
    ),
    "studies.other_sensors --sensors vlp16 --weights w.safetensors": ("vlp16",),
    "studies.fusion out data/sequences/08 --predict --weights w.safetensors": ("08  single",),
}


@pytest.fixture
def place(tmp_path, narrow_weights, monkeypatch):
    """Return a folder with scans, weights and a sensor; commands run in this process."""
    write_sequence(tmp_path / "data/sequences/08", map(str, range(6)), count=4000)
    (tmp_path / "tiny.toml").write_text(TINY + NOISE)
    (tmp_path / "w.safetensors").symlink_to(narrow_weights)

    def command(words, **_):
        result = called(*words[1:])
        return subprocess.CompletedProcess(words, 0, result.stdout.encode())

    monkeypatch.setattr(subprocess, "run", command)
    monkeypatch.setenv("SALSANEXT_ENGINE", "torch")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.usefixtures("place")
@pytest.mark.parametrize(
    "line",
    [*RUNS, *(pytest.param(line, marks=pytest.mark.slow) for line in SLOW_RUNS)],
    ids=lambda line: line.split()[0],
)
def test_a_script_prints_its_lines(line, capsys, monkeypatch):
    script, *words = line.split()
    monkeypatch.setattr(sys, "argv", [script, *words])
    runpy.run_path(find_spec(f"benchmarks.{script}").origin, run_name="__main__")
    printed = capsys.readouterr().out
    begins = (RUNS | SLOW_RUNS)[line]
    found = re.findall(f"^(?:{'|'.join(map(re.escape, begins))})", printed, re.MULTILINE)
    assert [*dict.fromkeys(found)] == [*begins], printed


@pytest.mark.slow
def test_speed_measures_each_part_of_both_sides_in_their_processes(tmp_path, weights, capsys):
    write_bin(tmp_path / "0.bin", make_scan())
    (tmp_path / "tiny.toml").write_text(TINY + NOISE)
    options = ("--weights", weights, "--device", "cpu", "--rounds", 1, "--threads", 1)
    options += ("--sensor", tmp_path / "tiny.toml", "--write", tmp_path / "speed.json")
    speed.main(*map(str, (tmp_path, *options)))
    assert "times as fast" in capsys.readouterr().out
    found = json.loads((tmp_path / "speed.json").read_text())["parts"]
    assert [part["part"] for part in found] == [*speed.PARTS]
    assert all(part["product"]["median"] > 0 for part in found)


@pytest.mark.slow
def test_sides_take_turns_on_the_same_scan(monkeypatch, tmp_path, weights):
    """Ratios are of pairs: a machine that is slow for a round is so for both sides."""
    seconds = {"baseline": iter((0.2, 9.0, 0.4)), "product": iter((0.1, 3.0, 0.4))}
    scans = make_scan(50), make_scan(70, 1)
    for name, scan in zip("ab", scans, strict=True):
        write_bin(tmp_path / f"{name}.bin", replace(scan, intensity=scan.intensity * 255))
    asked = []

    def turn(side, part, task, path):
        if part == "hardware":
            return {"machine": {}, "operations": 105e9, "bytes": 1e6}
        copy = read_scan(path)
        original = next(scan for scan in scans if len(scan) == len(copy))
        np.testing.assert_allclose(copy.intensity, original.intensity, rtol=1e-6)
        asked.append((side, len(copy)))
        return {"seconds": next(seconds[side]), "peak_bytes": 10**9}

    monkeypatch.setattr(speed, "take_turn", turn)
    network = NetworkSettings(weights, "cpu", sensor=IN_BYTES)
    (knn,) = speed.benchmark(tmp_path, network=network, parts=("knn",))["parts"]
    assert asked == [
        *(("product", 50), ("baseline", 50), ("baseline", 70)),
        *(("product", 70), ("product", 50), ("baseline", 50)),
    ]
    assert knn["ratio"] == pytest.approx({"median": 2.0, "lowest": 1.0, "highest": 3.0})
    assert (knn["baseline"]["median"], knn["product"]["median"]) == (0.4, 0.4)
    pixels = IN_BYTES.height * IN_BYTES.width
    assert knn["share_of_ceiling"] == pytest.approx((60 * 9 + pixels * 5) / 1e6 / 0.4)


def test_holes_are_counted_as_by_a_plain_loop():
    random = np.random.default_rng(0)
    ranges = np.where(random.random((8, 64)) < 0.3, 0, random.uniform(2, 60, (8, 64)))
    cells, kinds = hole_cells(ranges), HOLE_SHARES.shape[1]
    wanted = np.zeros((3, *HOLE_SHARES.shape), int)
    for (row, column), cell in np.ndenumerate(cells):
        right = (column + 1) % 64
        if cell >= 0:
            hole = ranges[row, column] == 0
            goes_on = hole and ranges[row, right] == 0 and cells[row, right] >= 0
            wanted[:, cell // kinds, cell % kinds] += [1, hole, goes_on]
    np.testing.assert_array_equal(hole_shares.count_holes(ranges), wanted)


def names(root: Path, split: str) -> list[str]:
    _, files = labelled_split(root, None, split)
    assert all(file.label_path.is_file() for file in files)
    return [f"{file.sequence}/{file.stem}" for file in files]


def test_streets_are_validated_with_real_scans_that_nothing_is_trained_on(tmp_path):
    """The second sensor has no scan at 04, the time from which the first one's are held out."""
    source, second, real, streets = (tmp_path / name for name in ("source", "gt", "real", "synth"))
    for sequence, count in (("001", 2), ("002", 12), ("003", 3)):
        write_sequence(source / f"sequences/{sequence}", [f"{2 * i:02}" for i in range(count)])
        write_sequence(second / f"sequences/{sequence}", ["03", "05", "22"], count=9)
    for _ in range(2):
        training = default_weights.link_pandaset({"pandaset": source, "pandargt": second}, real)
    of_pandaset = ["001/pandaset-001-00", "001/pandaset-001-02", "002/pandaset-002-00"]
    of_pandargt = ["001-03", "001-05", "001-22", "002-03"]
    assert names(real, "train") == [
        *(f"pandargt-{name[:3]}/pandargt-{name}" for name in of_pandargt),
        *(f"pandaset-{name}" for name in (*of_pandaset, "002/pandaset-002-02")),
    ]
    assert len(training) == len(names(real, "train"))
    held_out = [f"held-out-pandargt/pandargt-002-{stem}" for stem in ("05", "22")]
    held_out += [f"held-out-pandaset/pandaset-002-{2 * i:02}" for i in range(2, 12)]
    assert names(real, "valid") == held_out

    for sequence, stems in (("00", "ab"), ("08", "abcdefgh")):
        write_sequence(streets / "sequences" / sequence, stems, count=9)
    default_weights.link_streets(streets, real, tmp_path / "validated")
    assert names(tmp_path / "validated", "train") == ["00/00-a", "00/00-b"]
    assert names(tmp_path / "validated", "valid") == [
        *(f"valid-{name.replace('/', '/' + name.split('/')[0] + '-')}" for name in held_out),
        *("valid-streets/08-a", "valid-streets/08-e"),
    ]
    # What the held-out scans are labelled with means the same as in PandaSet's label space.
    both, own = map(data_set_label_space, (tmp_path / "validated", real))
    ids = np.array(list(own.learning_map), np.uint32)
    np.testing.assert_array_equal(both.to_train(ids), own.to_train(ids))


@pytest.mark.parametrize("name", ["pandaset", "aachen"])
def test_the_label_spaces_have_the_classes_of_semantickitti(name):
    space = label_space(Path(default_weights.__file__).with_name(f"{name}.yaml"))
    assert space.fits(label_space())
    for i, several in space.alternatives.items():
        assert space.learning_map[i] in several


ROAD, BUILDING = 40, 50


def corrupted(kind: str, severity: int, scan: Scan, labels: np.ndarray):
    model, levels = LEVELS[kind]
    return model(scan, labels, levels[severity], np.random.default_rng(1))


@pytest.mark.parametrize("kind", LEVELS)
def test_points_of_the_scene_keep_order_label_and_place(kind):
    """Their intensity only falls; nothing changes at severity 0, nor what is given."""
    scan = make_scan(2**16 - 1)
    raw = np.where(scan.points[:, 2] < -1.69, ROAD, BUILDING)
    labels = (raw | np.arange(len(scan)) << 16).astype(np.uint32)
    arguments = (scan.points, scan.intensity, labels)
    before = [array.copy() for array in arguments]
    for severity in range(4):
        changed = corrupted(kind, severity, scan, labels)
        assert len(changed.scan) == len(changed.labels) > 1000
        is_of_scene = changed.labels != 0
        number = (changed.labels >> 16)[is_of_scene]
        assert (np.diff(number.astype(int)) > 0).all()
        np.testing.assert_array_equal(changed.labels[is_of_scene], labels[number])
        assert (changed.scan.intensity[is_of_scene] <= scan.intensity[number]).all()
        if kind != "motion blur" or severity == 0:
            np.testing.assert_array_equal(changed.scan.points[is_of_scene], scan.points[number])
        if severity == 0:
            np.testing.assert_array_equal(changed.labels, labels)
            np.testing.assert_array_equal(changed.scan.intensity, scan.intensity)
        for old, argument in zip(before, arguments, strict=True):
            np.testing.assert_array_equal(old, argument)


@pytest.mark.parametrize("reflectivity", [0.02, 0.2])
def test_share_of_fog_echoes(reflectivity):
    """One cell of fog before the surface: the integral of exp(-needed / mean) over it."""
    visibility, ranges, count = 50.0, 5.0, 40_000
    points = np.tile(np.array([ranges, 0, 0], np.float32), (count, 1))
    scan = Scan(points, np.full(count, reflectivity, np.float32))
    labels = np.full(count, BUILDING, np.uint32)
    fog = LEVELS["fog"][0]
    changed = fog(scan, labels, 1000 / visibility, np.random.default_rng(0))
    depth = np.linspace(2, 5, 3001)
    extinction = np.log(20) / visibility
    needed = reflectivity * np.exp(-2 * extinction * ranges) / ranges**2
    mean = np.pi * 0.046 / visibility * 3 * np.exp(-2 * extinction * depth) / depth**2
    share = np.exp(-needed / mean).mean()
    assert 0.001 < share < 0.9
    assert (changed.labels == 0).mean() == pytest.approx(share, abs=4 * (share / count) ** 0.5)


def test_wet_ground():
    """Straight down F = ((n − 1) / (n + 1))²; walls stay dry; far ground is lost."""
    down, far, wall = [0, 0, -1.7], [30, 0, -1.7], [30, 1, 0]
    scan = Scan(np.array([down, far, wall], np.float32), np.full(3, 0.2, np.float32))
    labels = np.array([ROAD, ROAD, BUILDING], np.uint32)
    changed = corrupted("wet ground", 3, scan, labels)
    assert changed.labels.tolist() == [ROAD, BUILDING]
    reflected = (0.33 / 2.33) ** 2
    expected = 0.2 * (1 - reflected) ** 2 / 1.33**2 / (1 - 0.48 * 0.2)
    np.testing.assert_allclose(changed.scan.intensity, [expected, 0.2], rtol=1e-6)
    half = corrupted("wet ground", 2, scan, labels)
    assert half.scan.intensity[0] == pytest.approx((0.2 + expected) / 2)


ODD = replace(SMALL, height=17, width=120)
"""A size that the network has to pad."""


def table_of(scan: Scan) -> np.ndarray:
    return np.column_stack((scan.points, scan.intensity))


def with_holes(image: RangeImage) -> np.ndarray:
    """Return the channels as the baseline has them: -1 where a pixel is empty."""
    return np.where(image.channels[0] > 0, image.channels, np.float32(-1))


def is_inner(image: RangeImage) -> np.ndarray:
    """Return which points have a window that lies in the image."""
    v, u = np.divmod(image.pixel_of_point, image.width)
    return (v >= 2) & (v < image.height - 2) & (u >= 2) & (u < image.width - 2)


@pytest.mark.slow
def test_script_and_benchmark_label_a_scan_as_predict_does(tmp_path, weights):
    """No window of the points compared reaches an edge of the image, and all have a label."""
    scan, file = make_scan(), tmp_path / "000000.bin"
    write_bin(file, scan)
    words = (file, tmp_path / "plain.label", "--weights", weights)
    plain.main([str(word) for word in words])
    product.predict(file, tmp_path / "product.label", load_network(weights, "cpu"))
    predict_scans(file, tmp_path / "out", settings=NetworkSettings(weights, device="cpu"))
    (stage,) = (tmp_path / "out").rglob("*.label")
    assert (tmp_path / "product.label").read_bytes() == stage.read_bytes()
    theirs, labels = (read_labels(path, 1500) for path in (tmp_path / "plain.label", stage))
    compared = is_inner(project(scan, SMALL)) & (labels > 0)
    assert compared.mean() > 0.5
    assert np.mean(theirs[compared] != labels[compared]) <= 2e-3


@pytest.mark.slow
def test_both_sides_of_a_benchmark_do_the_same(tmp_path, weights):
    scan, sensor = tmp_path / "0.bin", ODD.to_dict()
    write_bin(scan, make_scan())
    image = project(make_scan(), ODD)
    _, variance = plain.Baseline(weights, sensor=sensor).aleatoric(with_holes(image))
    of_input = aleatoric(load_network(weights, "cpu", ODD), image)
    np.testing.assert_allclose(variance.numpy(), of_input, rtol=1e-3, atol=1e-12)
    task = {"weights": weights, "device": "cpu", "precision": "float32", "engine": "auto"}
    task |= {"sensor": sensor, "passes": 3, "samples": 3}
    for part in ("network", "knn", "confusion", "uncertainty"):
        theirs, ours = (side.prepare(part, scan, task)() for side in (plain, product))
        if part == "network":
            np.testing.assert_allclose(theirs, ours, atol=1e-4)
        elif part == "knn":
            assert np.mean(theirs == ours) > 0.8
        elif part == "confusion":
            assert theirs.sum() == ours.sum() == 1500
        else:
            # Three passes with other masks: alike on average.
            found = ours.uncertainty
            assert theirs[1].mean() == pytest.approx(found.epistemic.mean(), rel=0.5)
            assert theirs[2].mean() == pytest.approx(found.aleatoric.mean(), rel=0.5)
