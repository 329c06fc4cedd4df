# SPDX-License-Identifier: MIT
"""Compare two runs on the same labelled scans: IoU of each class, and whether a change is clear.

The change of a class is its IoU in the second run minus that in the first. It is clear if the mean
change of the sequences is more than twice its standard error over the sequences. Two sequences are
the least for that; with few of them, chance changes look clear too.

Both runs must be scored on the same scans and classes, none of which the weights were trained on.

Run: python examples/compare_runs.py out/eval.json tuned/eval.json, after `salsanext eval` on both
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

NAMES = {"accuracy": "accuracy", "iou_mean_present": "mean IoU"}
"""Scores of all classes, by their key in the results of `eval`."""


def percents(scores: dict[str, Any]) -> dict[str, float]:
    """Return accuracy, mean IoU, and the IoU of the classes in the labels, in percent."""
    shares = {name: scores[key] for key, name in NAMES.items()}
    shares |= {c["name"]: c["iou"] for c in scores["classes"] if c["points"]}
    return {name: 100 * share for name, share in shares.items() if share is not None}


def require_comparable(runs: list[dict[str, Any]]) -> None:
    """Exit if scores of two runs differ for other reasons than their labels."""
    if runs[0]["by_scan"].keys() != runs[1]["by_scan"].keys():
        sys.exit("the runs are scored on different scans: choose common ones with --sequences")
    if runs[0]["classes"] != runs[1]["classes"]:
        sys.exit("the runs have different classes: evaluate both with --classes")
    if any(run["on_training_scans"] for run in runs):
        sys.exit("the weights of a run were trained on these scans: evaluate others")
    if any(run["rejection"] for run in runs):
        sys.exit("a run rejected labels, which count as wrong: compare coverage and risk in `eval`")


def main(before: str, after: str) -> None:
    runs = [json.loads(Path(path).read_text("utf-8")) for path in (before, after)]
    require_comparable(runs)
    old, new = (percents(run["scores"]) for run in runs)
    sequences = zip(*(run["by_sequence"].values() for run in runs), strict=True)
    of_sequences = [tuple(map(percents, pair)) for pair in sequences]
    for name in old:
        changes = [b[name] - a[name] for a, b in of_sequences if name in a]
        line = f"{name:20} {old[name]:6.1f} → {new[name]:6.1f}  {new[name] - old[name]:+6.1f}"
        if len(changes) > 1:
            error = np.std(changes, ddof=1) / len(changes) ** 0.5
            line += "  clear" * bool(abs(np.mean(changes)) > 2 * error)
        print(line)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python examples/compare_runs.py OUT_A/eval.json OUT_B/eval.json")
    main(*sys.argv[1:])
