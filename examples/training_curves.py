# SPDX-License-Identifier: MIT
"""Plot the validation mIoU of trainings over the training time, and print it at equal times.

The time is that of the training steps, without validation. Compare runs on the same machine.

Run: python examples/training_curves.py curve.png runs/paper runs/modern
"""

import csv
import sys
from itertools import accumulate
from pathlib import Path

from matplotlib.figure import Figure

Curve = tuple[list[float], list[float]]
"""Minutes of training, and mIoU in %, of every validation."""


def read_curve(run: Path) -> Curve:
    """Read the log of a run."""
    with (run / "log.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    minutes = [total / 60 for total in accumulate(float(row["seconds"]) for row in rows)]
    validated = [number for number, row in enumerate(rows) if row.get("miou")]
    return (
        [minutes[number] for number in validated],
        [100 * float(rows[number]["miou"]) for number in validated],
    )


def at(minute: float, curve: Curve) -> float:
    """Return the best mIoU of a training up to a minute; 0 before the first validation."""
    return max((iou for time, iou in zip(*curve, strict=True) if time <= minute), default=0.0)


def main(picture: str, *runs: str) -> None:
    curves = {run: read_curve(Path(run)) for run in runs}
    if unscored := [run for run, (minutes, _) in curves.items() if not minutes]:
        sys.exit(f"not validated yet: {', '.join(unscored)}")
    shortest = min(minutes[-1] for minutes, _ in curves.values())

    axes = (figure := Figure(figsize=(7, 4.2), layout="constrained")).subplots()
    for name, (minutes, ious) in curves.items():
        axes.plot(minutes, ious, "o-", markersize=3, label=name)
        print(f"{name}: {at(shortest, (minutes, ious)):.1f} % within {shortest:.1f} minutes")
    axes.axvline(shortest, color="grey", linestyle=":", label="equal time")
    axes.set(xlabel="minutes of training", ylabel="validation mIoU, %", ylim=(0, None))
    axes.legend()
    figure.savefig(picture, dpi=120)


if __name__ == "__main__":
    main(*sys.argv[1:])
