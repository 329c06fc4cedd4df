# SPDX-License-Identifier: MIT
"""Figures of model-card.md: scores of weights on labelled data sets, as `predict` labels them.

Prints the IoU per class; then accuracy, mean IoU over the classes present, expected calibration
error, and mean IoU over the classes with at least 500 points, in %: as the scans are, without
intensity, and in coarse classes.

A data set whose labels have other classes needs two label spaces of the same classes: those that
the predictions are merged into, and those of its labels (docs/how-to/classes.md has both for
nuScenes).

Run: python -m benchmarks.weights.model_card folder/ NAME=DATASET[,CLASSES.yaml,LABELS.yaml]…
"""

import argparse
from pathlib import Path
from typing import Any

from benchmarks.commands import salsanext

VARIANTS: dict[str, tuple[str, ...]] = {
    "as they are": (),
    "--intensity none": ("--intensity", "none"),
    "--classes coarse": ("--classes", "coarse"),
}


def evaluated(dataset: str, out: Path, variant: str, weights: str) -> dict[str, Any] | None:
    """Predict a data set, unless that is done, and evaluate it; None for other classes twice."""
    path, *spaces = dataset.split(",")
    if spaces and "--classes" in VARIANTS[variant]:
        return None
    merged, labels = (
        (["--classes", spaces[0]], ["--label-space", spaces[1]]) if spaces else ([], [])
    )
    words = ("--weights", weights, *merged, *VARIANTS[variant])
    salsanext("predict", path, out, "--probabilities", *words)
    return salsanext("eval", out, *labels)


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
    datasets = dict(each.split("=", 1) for each in given.datasets)
    found = {
        variant: {
            name: evaluated(dataset, given.folder / f"{name}-{number}", variant, given.weights)
            for name, dataset in datasets.items()
        }
        for number, variant in enumerate(VARIANTS)
    }
    for variant in ("as they are", "--classes coarse"):
        print(f"IoU per class, {variant}\n")
        ious = [ious_of(result) for result in found[variant].values()]
        row("class", [*datasets])
        row("---", ["---"] * len(datasets))
        for name in dict.fromkeys(name for each in ious for name in each):
            row(name, [percent(each.get(name)) for each in ious])
        print()
    row("accuracy / mean IoU / ECE / mean IoU of ≥ 500 points", [*datasets])
    row("---", ["---"] * len(datasets))
    for variant, results in found.items():
        row(variant, [overall(result) for result in results.values()])


def ious_of(result: dict[str, Any] | None) -> dict[str, float | None]:
    """Return the IoU of the classes that the labels have."""
    classes = result["scores"]["classes"] if result else []
    return {each["name"]: each["iou"] if each["points"] else None for each in classes}


def overall(result: dict[str, Any] | None) -> str:
    """Return accuracy, mean IoU, expected calibration error and mean IoU of frequent classes."""
    if result is None:
        return "–"
    scores = result["scores"]
    mean, ece = scores["iou_mean_present"], result["calibration"]["ece"]
    return " / ".join(map(percent, (scores["accuracy"], mean, ece, scores["iou_mean_frequent"])))


if __name__ == "__main__":
    main()
