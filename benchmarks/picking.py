# SPDX-License-Identifier: MIT
"""Scores over the number of labelled scans, for each strategy of `pick` and several seeds.

Scans are picked from a labelled pool, get its labels in the place of a person's, and are trained
on. The weights are scored on the scans of another data set: accuracy and mean IoU over the classes
present in %, with the standard deviation over seeds. The seed is that of `pick` and of the
training. Complete runs are not repeated.

Run: python benchmarks/picking.py pool/ others/ folder/ [--counts 2 4 8] [--seeds 5]
     [--strategies both diverse] [--train --recipe finetune --epochs 4]
"""

import argparse
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.measures.scan_choice import STRATEGIES
from salsanext_cli.storage.layout import find_scans


def salsanext(*words: object) -> dict[str, Any]:
    """Run a command and return its JSON object."""
    command = ["salsanext", *map(str, words), "--json", "--quiet"]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def score(root: Path, given: argparse.Namespace, *how: object, seed: int) -> tuple[float, float]:
    """Pick into a folder, train and predict; return accuracy and mean IoU."""
    labelled, run, out = root / "labelled", root / "run", root / "out"
    if not (run / "best.safetensors").exists():
        picked = salsanext("pick", given.pool, labelled, *how, "--seed", seed)["picked"]
        names = {(each["sequence"], each["scan"]) for each in picked}
        for scan in find_scans(given.pool):
            if (scan.sequence, scan.stem) in names:
                target = labelled / "sequences" / scan.sequence / "labels" / scan.label_path.name
                shutil.copyfile(scan.label_path, target)
    salsanext("train", labelled, run, *given.train, "--set", f"seed={seed}")
    salsanext("predict", given.others, out, "--weights", run / "best.safetensors")
    scores = salsanext("eval", out)["scores"]
    return scores["accuracy"], scores["iou_mean_present"]


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("pool", type=Path)
    parser.add_argument("others", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--counts", type=int, nargs="+", default=[2, 4, 8])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--strategies", nargs="+", choices=STRATEGIES, default=STRATEGIES)
    parser.add_argument("--train", nargs=argparse.REMAINDER, default=["--recipe", "finetune"])
    given = parser.parse_args(words or None)
    for strategy in given.strategies:
        for count in given.counts:
            scores = []
            for seed in range(given.seeds):
                root = given.folder / f"{strategy}-{count}-{seed}"
                how = ("--count", count, "--strategy", strategy)
                scores.append(score(root, given, *how, seed=seed))
            (accuracy, miou), spread = 100 * np.mean(scores, axis=0), 100 * np.std(scores, axis=0)
            values = f"{accuracy:.1f} ± {spread[0]:.1f}  {miou:.1f} ± {spread[1]:.1f}"
            print(f"{strategy}, {count} scans  {values}", flush=True)


if __name__ == "__main__":
    main()
