# SPDX-License-Identifier: MIT
"""What a benchmark measures is what it says; how fast anything is, no test says."""

import mmap
import os
import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from scans import SMALL, make_scan, write_sequence, write_weights

import salsanext_cli
from salsanext_cli.benchmarking import benchmark as stage
from salsanext_cli.benchmarking import memory as benchmark_memory
from salsanext_cli.benchmarking import sides as benchmark_sides
from salsanext_cli.benchmarking import watch as benchmark_watch
from salsanext_cli.benchmarking.benchmark import Plan, benchmark, require_new
from salsanext_cli.benchmarking.ceiling import Ceiling, floors, measure_ceiling
from salsanext_cli.benchmarking.commands import run
from salsanext_cli.benchmarking.machine import Machine, _told
from salsanext_cli.benchmarking.processes import Line, serve, thread_variables
from salsanext_cli.benchmarking.result import Measured, Turn
from salsanext_cli.benchmarking.sides import Baseline, Product, Task, baseline_path
from salsanext_cli.benchmarking.watch import Watch
from salsanext_cli.errors import FormatError, OutputError, SalsanextError, UsageError, WeightsError
from salsanext_cli.formats import read_scan
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.network.salsanext import SalsaNext
from salsanext_cli.network.weights import read_card
from salsanext_cli.storage.layout import ScanFile, find_scans
from salsanext_cli.storage.point_files import write_bin

CPU = torch.device("cpu")
posix = pytest.mark.skipif(sys.platform == "win32", reason="benchmark needs POSIX")


@pytest.fixture
def task(tmp_path, weights):
    """Return what both sides are to do with two small scans."""
    for number in range(2):
        write_bin(tmp_path / f"scans/{number}.bin", make_scan(500, number))
    (tmp_path / "out").mkdir()
    return Task(
        NetworkSettings(weights, "cpu", SMALL), tmp_path / "scans", tmp_path / "out", passes=1
    )


def test_the_plan_is_checked():
    with pytest.raises(UsageError, match=r"--parts · nets · .*projection, network"):
        Plan(("network", "nets"))
    for wrong in ({"rounds": 0}, {"passes": 0}, {"threads": 0}):
        with pytest.raises(UsageError, match=r"0 · expected at least 1"):
            Plan(**wrong)


def test_what_cannot_be_measured_is_refused(tmp_path, weights):
    write_bin(tmp_path / "1.bin", make_scan(10))
    silent = replace(SMALL, range_noise=None)
    with pytest.raises(UsageError, match="noise is not known"):
        benchmark(tmp_path, network=NetworkSettings(weights, "cpu", silent))
    certain = write_weights(tmp_path / "certain.safetensors", dropout=0.0)
    with pytest.raises(WeightsError, match=r"without dropout .* --parts"):
        benchmark(tmp_path, network=NetworkSettings(certain, "cpu"))
    (tmp_path / "there.json").write_text("")
    with pytest.raises(OutputError, match="exists"):
        require_new(tmp_path / "there.json")


def test_other_networks_have_no_baseline(monkeypatch, tmp_path, weights):
    card = replace(read_card(weights), architecture={"name": "salsanet"})
    monkeypatch.setattr(stage, "read_card", lambda path: card)
    with pytest.raises(WeightsError, match="architecture salsanet"):
        benchmark(tmp_path, network=NetworkSettings(weights, "cpu"))


def test_few_scans_are_repeated_and_intensities_scaled_once(tmp_path):
    scan = make_scan(50)
    loud = replace(scan, intensity=scan.intensity * 255)
    write_bin(tmp_path / "a.bin", loud)
    write_bin(tmp_path / "b.bin", make_scan(70, 1))
    folder = tmp_path / "copies"
    points = stage._copy(find_scans(tmp_path), replace(SMALL, intensity_scale=255.0), folder)
    assert points == [50, 70]
    copies = [read_scan(file.path) for file in find_scans(folder)]
    assert [len(copy) for copy in copies] == [50, 70, 50, 70]
    np.testing.assert_allclose(copies[2].intensity, scan.intensity, rtol=1e-6)


class Recorder:
    """A side that notes when it is asked."""

    def __init__(self, side: str, asked: list[tuple[str, ...]]) -> None:
        self.side, self.asked = side, asked

    def ask(self, question: str, part: str, scan: ScanFile) -> Turn:
        self.asked.append((self.side, part, scan.stem))
        return Turn({"baseline": 6.0, "product": 2.0}[self.side])


def test_sides_take_turns_on_the_same_scan():
    asked: list[tuple[str, ...]] = []
    scans = [ScanFile("00", stem, Path(stem)) for stem in ("a", "b")]
    lines = {side: Recorder(side, asked) for side in ("baseline", "product")}
    turns = stage._Turns(lines, None, scans)
    for number in range(3):
        turns.take("knn", number)
    sides = [side for side, _, _ in asked]
    assert sides == ["product", "baseline", "baseline", "product", "product", "baseline"]
    assert [stem for _, _, stem in asked] == ["a", "a", "b", "b", "a", "a"]
    (measured,) = turns.measured({"knn": 0.5})
    found = measured.to_dict()
    assert found["ratio"] == {"median": 3.0, "lowest": 3.0, "highest": 3.0}
    assert (found["baseline"]["median"], found["product"]["median"]) == (6.0, 2.0)
    assert found["share_of_ceiling"] == 0.25


def test_ratios_are_of_pairs():
    """A machine that is slow for a round is so for both sides."""
    plain, ours = (Turn(1.0, 10), Turn(90.0, 30), Turn(2.0)), (Turn(0.5), Turn(30.0), Turn(2.0))
    found = Measured("knn", plain, ours).to_dict()
    assert found["ratio"] == {"median": 2.0, "lowest": 1.0, "highest": 3.0}
    assert found["baseline"] == {
        "median": 2.0,
        "seconds": [1.0, 90.0, 2.0],
        "peak_bytes": 30,
        "device_peak_bytes": None,
    }
    assert found["floor"] is None
    assert found["share_of_ceiling"] is None


def test_a_part_without_baseline_has_no_ratio():
    found = Measured("help", (), (Turn(0.2),)).to_dict()
    assert (found["baseline"], found["ratio"]) == (None, None)
    with pytest.raises(ValueError, match="longer"):
        _ = Measured("knn", (Turn(1.0),), (Turn(1.0), Turn(1.0))).ratios


def test_floors(weights):
    """At a thousand operations and one byte per second, bytes take longer but for the network."""
    sensor, points = SMALL, 1000
    pixels = sensor.height * sensor.width
    bytes_only = floors(read_card(weights), sensor, points, Ceiling("float32", 1e30, 1.0))
    assert bytes_only["projection"] == points * (16 + 8) + pixels * (5 * 4 + 4)
    assert bytes_only["knn"] == points * 9 + pixels * 5
    assert bytes_only["confusion"] == 2 * points
    operations = floors(read_card(weights), sensor, points, Ceiling("float32", 1.0, 1e30))
    counted = 0

    def count(layer, inputs, output):
        nonlocal counted
        counted += output[0, 0].numel() * layer.weight.numel()

    module = SalsaNext(20).eval()
    for layer in module.modules():
        if isinstance(layer, torch.nn.Conv2d):
            layer.register_forward_hook(count)
    module(torch.zeros(1, 5, sensor.height, sensor.width))
    # A bias is one more weight for each number that comes out.
    assert operations["network"] == pytest.approx(2 * counted, rel=0.01)
    assert operations["network"] == operations["predict"]


def test_ceilings_are_those_of_the_clock(monkeypatch):
    monkeypatch.setattr("salsanext_cli.benchmarking.ceiling.SIDE", {"cpu": 64})
    monkeypatch.setattr("salsanext_cli.benchmarking.ceiling.BYTES", {"cpu": 1 << 16})
    clock = iter(range(100))
    monkeypatch.setattr("time.perf_counter", lambda: next(clock))
    found = measure_ceiling(CPU, "float32")
    assert found == Ceiling("float32", 2 * 64**3, 2 << 16)
    best = found.better(Ceiling("float32", 1e12, 1.0))
    assert best == Ceiling("float32", 1e12, 2 << 16)
    assert best.seconds(int(3e12), 2 << 16) == 3


def test_quick_parts_are_repeated_and_the_median_counts(monkeypatch, task):
    watch = Watch.__new__(Watch)
    watch.device, watch.warm, calls = CPU, set(), []
    file = find_scans(task.scans)[0]
    watch.parts = {file.path: {"knn": (lambda: calls.append(1), 3.0)}}
    clock = iter([0, 9] + [0.0, 0.1, 0.1, 0.2, 0.2, 0.4])
    monkeypatch.setattr(benchmark_watch.time, "perf_counter", lambda: next(clock))
    turn = watch.turn("knn", file)
    assert len(calls) == 1 + 3
    assert turn.seconds == pytest.approx(3 * 0.1)


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="not Linux")
def test_peak_memory_is_of_what_came_after():
    benchmark_memory.forget_peak(CPU)
    before, _ = benchmark_memory.peak_memory(CPU)
    # Of the system, not of what this process may have kept.
    block = mmap.mmap(-1, 100 << 20)
    block.write(bytes(100 << 20))
    grown, on_device = benchmark_memory.peak_memory(CPU)
    assert before + (90 << 20) < grown < before + (200 << 20)
    assert on_device is None
    block.close()
    benchmark_memory.forget_peak(CPU)
    assert benchmark_memory.peak_memory(CPU)[0] < grown - (90 << 20)


def test_no_memory_where_nobody_tells(monkeypatch, tmp_path):
    monkeypatch.setattr(benchmark_memory, "PROCESS", tmp_path / "none")
    benchmark_memory.forget_peak(CPU)
    assert benchmark_memory.peak_memory(CPU) == (None, None)


def test_the_processor_is_named(tmp_path):
    path = tmp_path / "cpuinfo"
    path.write_text("model name\t: Some CPU @ 2: GHz\nflags\t\t: fpu avx2\n\nmodel name : other\n")
    assert _told(path) == {"model name": "Some CPU @ 2: GHz", "flags": "fpu avx2"}
    assert _told(tmp_path / "none") == {}
    here = Machine.here(CPU)
    assert here.processor
    assert (here.threads, here.device) == (torch.get_num_threads(), "cpu")


def test_both_sides_do_the_same_parts_alike(task, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    sides = Baseline(task), Product(task)
    file = find_scans(task.scans)[0]
    plain, ours = ({n: (w(), k) for n, (w, k) in side.parts(file).items()
                    if n != "uncertainty"} for side in sides)  # fmt: skip
    assert plain.keys() == ours.keys() == set(stage.IN_PROCESS) - {"predict", "uncertainty"}
    np.testing.assert_allclose(plain["network"][0], ours["network"][0], atol=1e-4)
    np.testing.assert_array_equal(plain["projection"][0][1], ours["projection"][0].pixel_of_point)
    assert np.mean(plain["knn"][0] == ours["knn"][0]) > 0.8
    assert plain["confusion"][0].sum() == ours["confusion"][0].total == 500
    assert {factor for _, factor in (*plain.values(), *ours.values())} == {1}
    assert sides[0].parts(file)["uncertainty"][1] == 30
    assert sides[1].parts(file)["uncertainty"][1] == 1
    assert all(side.predict() > 0 for side in sides)


def test_a_scan_that_fails_ends_it(task):
    side = Product(task)
    (task.scans / "1.bin").write_bytes(b"1")
    with pytest.raises(SalsanextError, match="1 bytes"):
        side.predict()


def test_the_baseline_is_found_in_a_package_and_beside_it(monkeypatch, tmp_path):
    assert baseline_path().read_text("utf-8").startswith("# SPDX")
    package = tmp_path / "salsanext_cli/__init__.py"
    monkeypatch.setattr(salsanext_cli, "__file__", str(package))
    with pytest.raises(SalsanextError, match=r"baseline\.py · no such file"):
        baseline_path()
    for folder in (tmp_path / "benchmarks", package.parent / "benchmarks"):
        folder.mkdir(parents=True)
        (folder / "baseline.py").write_text("")
        assert baseline_path() == folder / "baseline.py"


def test_threads_are_told_by_the_environment():
    assert set(thread_variables(3).values()) == {"3"}
    assert thread_variables(None) == {}


@posix
def test_commands_are_timed(monkeypatch):
    """A process smaller than the one that starts it begins with the memory of that one."""
    work = "import time; time.sleep(0.3); block = bytearray(b'1') * (200 << 20)"
    wall, processor, _ = run((sys.executable, "-c", work), {})
    assert 0.3 <= wall < 30
    assert 0 < processor < wall
    for own, told in ((1, True), (1 << 40, False)):
        monkeypatch.setattr("resource.getrusage", lambda _, own=own: Mock(ru_maxrss=own))
        _, _, peak = run((sys.executable, "-c", work), {})
        assert (peak is not None and peak > 200 << 20) == told
    with pytest.raises(SalsanextError, match="last words"):
        run((sys.executable, "-c", "import sys; sys.exit('first\\nlast words')"), {})


class Script:
    """The other end of a line: what comes from it, and what was sent to it."""

    def __init__(self, *coming: object) -> None:
        self.coming, self.sent = list(coming), []

    def recv(self) -> object:
        if not self.coming:
            raise EOFError
        return self.coming.pop(0)

    def send(self, sent: object) -> None:
        self.sent.append(sent)


def test_mistakes_are_answers(monkeypatch, task):
    monkeypatch.setattr("signal.signal", lambda *_: None)
    monkeypatch.setenv("OMP_NUM_THREADS", "")
    missing = ScanFile("00", "none", task.scans / "none.bin")
    script = Script(
        (replace(task, network=NetworkSettings(Path("none.safetensors"), "cpu", SMALL)),),
        (task,),
        ("turn", "knn", missing),
        ("precision",),
    )
    serve("product", {"OMP_NUM_THREADS": "7"}, script)
    no_weights, ready, no_scan, precision = script.sent
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert (ready, precision) == (None, "float32")
    assert isinstance(no_weights, WeightsError)
    with pytest.raises(FormatError, match=r"none\.bin"):
        Line("product", Script(no_scan)).ask("turn")


def test_a_process_that_dies_is_named():
    with pytest.raises(SalsanextError, match="benchmark, baseline · its process ended"):
        Line("baseline", Script()).ask("machine")


@posix
@pytest.mark.slow
def test_everything_is_measured(tmp_path, weights):
    """One round of all parts, both sides in their processes."""
    write_sequence(tmp_path / "08", ["000000"])
    seen: list[tuple[int, int]] = []
    found = benchmark(
        tmp_path / "08",
        network=NetworkSettings(weights, "cpu", replace(SMALL, width=64)),
        plan=Plan(rounds=1, threads=1),
        progress=lambda done, total: seen.append((done, total)),
    ).to_dict()
    assert seen == [(n, 8) for n in range(1, 9)]
    assert found["machine"]["threads"] == 1
    assert found["settings"]["points"] == [1500]
    assert found["settings"]["sensor"] == {"name": "small", "height": 16, "width": 64}
    assert [part["part"] for part in found["parts"]] == list(stage.PARTS)
    for part in found["parts"]:
        assert part["product"]["median"] > 0
        assert (part["ratio"] is None) == (part["part"] == "help")
    assert 0 < found["parts"][1]["share_of_ceiling"] < 1.5
    assert benchmark_sides.SAMPLES == 30
