# SPDX-License-Identifier: MIT
"""Figures of docs/model-card.md: scores of weights on labelled data sets, as `predict` labels them.

Prints the IoU per class; then accuracy, mean IoU over the classes present and expected calibration
error in %, as the scans are, with batch norm adapted, without intensity, and in coarse classes.

Run: python benchmarks/model_card.py folder/ NAME=DATASET… [--weights FILE]
"""

import argparse
import json
import subprocess
from pathlib import Path
from typing import Any

VARIANTS: dict[str, tuple[str, ...]] = {
    "as they are": (),
    "--adapt": ("--adapt",),
    "--intensity none": ("--intensity", "none"),
    "--classes coarse": ("--classes", "coarse"),
}


def salsanext(*words: str | Path) -> dict[str, Any]:
    """Run a command and return its JSON object."""
    command = ["salsanext", *map(str, words), "--json", "--quiet"]
    found: dict[str, Any] = json.loads(subprocess.run(command, check=True, stdout=-1).stdout)
    return found


def evaluated(dataset: Path, out: Path, *words: str) -> dict[str, Any]:
    """Predict a data set, unless that is done, and evaluate it."""
    salsanext("predict", dataset, out, "--probabilities", *words)
    return salsanext("eval", out, "--dataset", dataset)


def row(title: str, cells: list[str]) -> None:
    print(f"| {title} | {' | '.join(cells)} |")


def percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f}"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("datasets", nargs="+", metavar="NAME=DATASET")
    parser.add_argument("--weights", default="default")
    given = parser.parse_args()
    paths = {name: Path(path) for name, _, path in (each.partition("=") for each in given.datasets)}
    found = {
        (variant, name): evaluated(
            path, given.folder / f"{name}-{number}", "--weights", given.weights, *words
        )
        for number, (variant, words) in enumerate(VARIANTS.items())
        for name, path in paths.items()
    }
    usual = [found[next(iter(VARIANTS)), name]["scores"]["classes"] for name in paths]
    row("class", [*paths])
    row("---", ["---"] * len(paths))
    for classes in zip(*usual, strict=True):
        ious = [score["iou"] if score["points"] else None for score in classes]
        row(classes[0]["name"], [percent(iou) for iou in ious])
    print()
    row("accuracy / mean IoU / ECE", [*paths])
    row("---", ["---"] * len(paths))
    for variant in VARIANTS:
        results = [found[variant, name] for name in paths]
        overall = [
            (each["scores"]["accuracy"], each["scores"]["iou_mean_present"]) for each in results
        ]
        errors = [each["calibration"]["ece"] for each in results]
        cells = [[*both, error] for both, error in zip(overall, errors, strict=True)]
        row(variant, [" / ".join(map(percent, each)) for each in cells])


if __name__ == "__main__":
    main()
