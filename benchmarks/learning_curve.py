# SPDX-License-Identifier: MIT
"""Learning curve: scores on places left out over the number of labelled scans, from two starts.

For every draw a fold of the data set's sequences is left out, and scans are drawn from the rest.
The recipe `finetune` trains on them, from the default weights and from random ones, for a fixed
number of epochs, and the last epoch is scored on what was left out. Complete runs are not repeated.
Each line is printed as its runs end, and `curve.png` drawn at the end.

Run: python benchmarks/learning_curve.py semantickitti/ folder/ [--counts 1 2 4 8] [--draws 3]
"""

import argparse
import csv
import json
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from salsanext_cli import label_space
from salsanext_cli.storage.layout import ScanFile, find_scans
from salsanext_cli.storage.selection import data_set_label_space
from salsanext_cli.training.cross_validation import folds

STARTS = ("default", "random")


def link(files: Sequence[ScanFile], split: str, root: Path) -> None:
    """Make links to scans and labels as a sequence of a data set."""
    for file in files:
        for path in (file.path, file.label_path):
            target = root / "sequences" / split / path.parent.name
            target.mkdir(parents=True, exist_ok=True)
            place = target / f"{file.sequence}-{path.name}"
            if not place.is_symlink():
                place.symlink_to(path.resolve())


def score(root: Path, start: str, epochs: int) -> tuple[float, float]:
    """Train on the data set at a root, and return accuracy and mean IoU of the last epoch."""
    run = root / f"from-{start}"
    changes = ("--set", f"initial={start}", "--set", "folds=0", "--epochs", str(epochs))
    sensor = ("--sensor", "hdl64-512", "--jobs", "2", "--quiet")
    subprocess.run(
        ["salsanext", "train", root, run, "--recipe", "finetune", *changes, *sensor], check=True
    )
    with (run / "log.csv").open() as file:
        last = list(csv.DictReader(file))[-1]
    return float(last["accuracy"]), float(last["miou"])


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("dataset", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--counts", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--draws", type=int, default=3)
    parser.add_argument("--epochs", type=int, default=4)
    given = parser.parse_args(words or None)
    space = (data_set_label_space(given.dataset) or label_space()).to_dict()
    space["split"] = {"train": ["train"], "valid": ["valid"]}
    files = [file for file in find_scans(given.dataset) if file.label_path.is_file()]
    parts = folds(files, given.draws)
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot(xlabel="labelled scans", ylabel="mIoU on other places, %")
    for start in STARTS:
        means = []
        for count in given.counts:
            scores = []
            for draw, left_out in enumerate(parts):
                others = [file for file in files if file not in left_out]
                chosen = np.random.default_rng(draw).permutation(len(others))[:count]
                root = given.folder / f"{count}-{draw}"
                link([others[i] for i in sorted(chosen)], "train", root)
                link(left_out, "valid", root)
                (root / "labels.yaml").write_text(json.dumps(space))
                scores.append(score(root, start, given.epochs))
            (accuracy, miou), spread = 100 * np.mean(scores, axis=0), 100 * np.std(scores, axis=0)
            name = f"{start}, {count} scans"
            print(
                f"{name}  {accuracy:.1f} ± {spread[0]:.1f}  {miou:.1f} ± {spread[1]:.1f}",
                flush=True,
            )
            means.append((miou, spread[1]))
        values, spreads = zip(*means, strict=True)
        axes.errorbar(
            given.counts, values, spreads, fmt=".-", capsize=3, label=f"from {start} weights"
        )
    axes.legend()
    figure.savefig(given.folder / "curve.png", dpi=120)


if __name__ == "__main__":
    main()
