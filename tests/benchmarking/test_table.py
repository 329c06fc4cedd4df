# SPDX-License-Identifier: MIT
"""The table of a benchmark."""

import io

from rich.console import Console

from salsanext_cli.benchmarking.ceiling import Ceiling
from salsanext_cli.benchmarking.machine import Machine
from salsanext_cli.benchmarking.result import Benchmark, Measured, Turn
from salsanext_cli.benchmarking.table import benchmark_table

SETTINGS = {
    "sensor": {"name": "small", "height": 16, "width": 128},
    "points": [1000, 2001],
    "rounds": 2,
    "samples": 30,
    "baseline_passes_timed": 1,
}


def shown(*parts: Measured, device: str = "cpu", **settings: object) -> str:
    machine = Machine("Some CPU", ("avx2",), 2, "2.13", device)
    ceiling = Ceiling("float32", 105e9, 9.84e9)
    found = Benchmark(machine, ceiling, SETTINGS | settings, parts).to_dict()
    stream = io.StringIO()
    Console(file=stream, width=120).print(benchmark_table(found))
    return stream.getvalue()


def row(text: str, start: str) -> list[str]:
    (line,) = (line for line in text.splitlines() if line.startswith(f"│ {start}"))
    return [cell.strip() for cell in line.strip("│").split("│")]


def test_rows():
    knn = Measured(
        "knn", (Turn(0.1, 10**9), Turn(0.3)), (Turn(0.01, 2 * 10**9), Turn(0.02)), floor=0.003
    )
    text = shown(knn, Measured("help", (), (Turn(0.2504),)))
    assert row(text, "kNN") == [
        "kNN",
        "200 ms",
        "15 ms",
        "12.5 × (10 to 15)",
        "20.0%",
        "1.00 / 2.00",
    ]
    assert row(text, "salsanext") == ["salsanext --help", "–", "250 ms", "–", "–", "–"]
    assert "Some CPU (avx2), 2 threads, torch 2.13" in text
    assert "small, 16×128, float32; 2 scans of 1,500 points on average" in text
    assert "105 GFLOP/s of a matrix product in float32, 9.8 GB/s of a memory copy" in text
    assert "passes, all alike" not in text


def test_passes_that_were_not_timed_are_told():
    part = Measured("uncertainty", (Turn(60.0),), (Turn(2.0),))
    text = shown(part)
    assert row(text, "uncertainty")[:4] == [
        *("uncertainty, 30 passes", "60.00 s", "2.00 s"),
        "30 × (30 to 30)",
    ]
    assert "Of the baseline's 30 passes, all alike, 1 is timed." in text
    assert "30 passes, all alike, 2 are timed." in shown(part, baseline_passes_timed=2)
    assert "all alike" not in shown(part, baseline_passes_timed=30)


def test_memory_is_that_of_the_gpu():
    part = Measured("network", (Turn(1.0, 10**9, 3 * 10**9),), (Turn(1.0, 10**9, 10**9),))
    text = shown(part, device="Some GPU")
    assert row(text, "network")[-1] == "3.00 / 1.00"
    assert "torch 2.13, Some GPU" in text
