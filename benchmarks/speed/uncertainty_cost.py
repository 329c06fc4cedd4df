# SPDX-License-Identifier: MIT
"""Cost of each way to estimate uncertainty, as a multiple of a deterministic pass in the same run.

Every round times each way once, so that other work on the machine slows all of them; printed are
medians and the range of the rounds.

Run: python -m benchmarks.speed.uncertainty_cost 000000.bin [hdl64 30 5 weights.safetensors]
"""

import statistics
import sys
import time
from collections.abc import Callable

import salsanext_cli as sn
from salsanext_cli.core.uncertainty.aleatoric import aleatoric, noise_variance
from salsanext_cli.core.uncertainty.monte_carlo import sample


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def main(
    scan: str,
    sensor: str = "hdl64",
    samples: str = "30",
    rounds: str = "5",
    weights: str | None = None,
) -> None:
    network = sn.load_network(weights, device="cpu", sensor=sn.sensor(sensor))
    image = sn.project(sn.read_scan(scan), network.sensor)
    passes = int(samples)
    ways: dict[str, Callable[[], object]] = {
        "one deterministic pass": lambda: network.probabilities(image),
        f"{passes} passes of dropout": lambda: sample(network, image, samples=passes, seed=0),
        "assumed density filtering": lambda: aleatoric(network, image),
        "eight noisy copies": lambda: noise_variance(network, image, 0),
    }
    ways["one deterministic pass"]()
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(int(rounds)):
        for name, way in ways.items():
            times[name].append(seconds(way))
    base, dropout, _, copies = times.values()
    times["dropout and noisy copies"] = [a + b for a, b in zip(dropout, copies, strict=True)]
    for name, measured in times.items():
        ratios = [t / b for t, b in zip(measured, base, strict=True)]
        median, low, high = statistics.median(ratios), min(ratios), max(ratios)
        spread = f"{median:5.1f} × ({low:.1f} to {high:.1f})"
        print(f"{name:32}{statistics.median(measured):8.2f} s {spread}")


if __name__ == "__main__":
    main(*sys.argv[1:])
