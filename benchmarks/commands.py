# SPDX-License-Identifier: MIT
"""Commands of salsanext, for the scripts that measure with them."""

import json
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli import label_space
from salsanext_cli.runs.results.paths import ScanFile
from salsanext_cli.runs.results.selection import data_set_label_space


def salsanext(*words: object) -> dict[str, Any]:
    """Run a command and return its JSON object."""
    command = ["salsanext", *map(str, words), "--json", "--quiet"]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def link(file: ScanFile, sequence: Path) -> None:
    """Make links to a scan and its labels in a sequence."""
    for path in (file.path, file.label_path):
        place = sequence / path.parent.name / f"{file.sequence}-{path.name}"
        place.parent.mkdir(parents=True, exist_ok=True)
        if not place.is_symlink():
            place.symlink_to(path.resolve())


def link_data_set(source: Path, root: Path, splits: Mapping[str, Sequence[ScanFile]]) -> None:
    """Make a data set of links to labelled scans of another, whose splits have a sequence each."""
    for split, files in splits.items():
        for file in files:
            link(file, root / "sequences" / split)
    space = (data_set_label_space(source) or label_space()).to_dict()
    space["split"] = {split: [split] for split in splits}
    (root / "labels.yaml").write_text(json.dumps(space))


def scored(scans: Path, out: Path, weights: object, *options: object) -> tuple[float, float]:
    """Predict labelled scans; return accuracy and mean IoU over the classes present."""
    salsanext("predict", scans, out, "--weights", weights, *options)
    scores = salsanext("eval", out)["scores"]
    return scores["accuracy"], scores["iou_mean_present"]


def mean_and_spread(name: str, scores: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Print means and standard deviations of accuracies and mean IoUs in %; return the latter's."""
    (accuracy, miou), spread = 100 * np.mean(scores, axis=0), 100 * np.std(scores, axis=0)
    print(f"{name}  {accuracy:.1f} ± {spread[0]:.1f}  {miou:.1f} ± {spread[1]:.1f}", flush=True)
    return miou, spread[1]
