# SPDX-License-Identifier: MIT
"""Scores over the number of labelled scans, for several seeds of `pick`.

Scans are picked from a labelled pool, get its labels in the place of a person's, and are trained
on with the recipe `finetune`. The weights of the end are scored on the scans of another data set of
the same label space: accuracy and mean IoU over the classes present in %, with the standard
deviation over seeds. The seed is that of `pick` and of the training. Complete runs are not
repeated.

Run: python benchmarks/picking.py pool/ others/ folder/ [--counts 2 4 8] [--seeds 5]
     [--weights default] [--train --epochs 2]
"""

import argparse
from pathlib import Path

from commands import link_data_set, mean_and_spread, salsanext, scored

from salsanext_cli.runs.results.paths import find_scans


def score(root: Path, given: argparse.Namespace, *how: object, seed: int) -> tuple[float, float]:
    """Pick into a folder, train and predict; return accuracy and mean IoU."""
    labelled, run = root / "labelled", root / "run"
    weights = ("--weights", given.weights)
    if not (run / "last.safetensors").exists():
        picked = salsanext("pick", given.pool, root / "picked", *how, "--seed", seed, *weights)
        names = {(each["sequence"], each["scan"]) for each in picked["picked"]}
        files = [scan for scan in find_scans(given.pool) if (scan.sequence, scan.stem) in names]
        link_data_set(given.pool, labelled, {"train": files, "valid": find_scans(given.others)})
    train = ("--set", f"seed={seed}", "--set", "folds=0", *given.train)
    salsanext("train", labelled, run, "--recipe", "finetune", *weights, *train)
    return scored(labelled, root / "out", run / "last.safetensors", "--split", "valid")


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("pool", type=Path)
    parser.add_argument("others", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--counts", type=int, nargs="+", default=[2, 4, 8])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--weights", default="default")
    parser.add_argument("--train", nargs=argparse.REMAINDER, default=[])
    given = parser.parse_args(words or None)
    for count in given.counts:
        scores = []
        for seed in range(given.seeds):
            root = given.folder / f"{count}-{seed}"
            scores.append(score(root, given, "--count", count, seed=seed))
        mean_and_spread(f"{count} scans", scores)


if __name__ == "__main__":
    main()
