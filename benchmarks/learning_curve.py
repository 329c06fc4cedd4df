# SPDX-License-Identifier: MIT
"""Learning curve: scores on places left out over the number of labelled scans, in two ways.

For every draw a fold of the data set's sequences is left out, and scans are drawn from the rest.
The recipe `finetune` trains on them, from the default weights and from random ones, with the same
number of steps. Both predict what was left out. Complete runs are not repeated. Each line is
printed as its runs end, and `curve.png` drawn at the end.

Run: python benchmarks/learning_curve.py semantickitti/ folder/ [--counts 1 2 4 8] [--draws 3]
     [--train --epochs 2]
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from commands import link_data_set, mean_and_spread, salsanext, scored
from matplotlib.figure import Figure

from salsanext_cli.runs.results.paths import find_scans
from salsanext_cli.training.cross_validation import folds

WAYS = {"default": "fine-tuned default weights", "random": "random weights, trained alike"}


def score(root: Path, way: str, options: Sequence[str]) -> tuple[float, float]:
    """Train on the data set at a root; return accuracy and mean IoU of its rest."""
    run, sensor = root / way, ("--sensor", "hdl64-512")
    own = ("--recipe", "finetune", "--set", f"initial={way}", "--set", "folds=0")
    salsanext("train", root, run, *own, *sensor, "--jobs", 2, *options)
    return scored(root, run / "out", run / "last.safetensors", "--split", "valid", *sensor)


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("dataset", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--counts", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--draws", type=int, default=3)
    parser.add_argument("--train", nargs=argparse.REMAINDER, default=[])
    given = parser.parse_args(words or None)
    files = [file for file in find_scans(given.dataset) if file.label_path.is_file()]
    parts = folds(files, given.draws)
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot(xlabel="labelled scans", ylabel="mIoU on other places, %")
    for way, title in WAYS.items():
        points = []
        for count in given.counts:
            scores = []
            for draw, left_out in enumerate(parts):
                others = [file for file in files if file not in left_out]
                chosen = np.random.default_rng(draw).permutation(len(others))[:count]
                root = given.folder / f"{count}-{draw}"
                drawn = [others[i] for i in sorted(chosen)]
                link_data_set(given.dataset, root, {"train": drawn, "valid": left_out})
                scores.append(score(root, way, given.train))
            points.append(mean_and_spread(f"{way}, {count} scans", scores))
        values, spreads = zip(*points, strict=True)
        axes.errorbar(given.counts, values, spreads, fmt=".-", capsize=3, label=title)
    axes.legend()
    figure.savefig(given.folder / "curve.png", dpi=120)


if __name__ == "__main__":
    main()
