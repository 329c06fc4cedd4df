# SPDX-License-Identifier: MIT
"""Adapt the network to your own sensor with a few labelled scans: pick, label, train, predict.

A simulated drive with a sensor that the weights have not seen stands for your own scans. Its last
quarter is held out. Some of the other scans are picked, and the truth replaces manual labels.

Run: python examples/few_labels.py folder/ [4 24 finetune weights.safetensors]
"""

import shutil
import sys
from pathlib import Path

import numpy as np

import salsanext_cli as sn
from salsanext_cli.commands.stages.import_labels import import_labels
from salsanext_cli.commands.stages.pick import pick
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.commands.stages.synth import synthesise
from salsanext_cli.commands.stages.train import train
from salsanext_cli.core.measures.scores import confusion_matrix, scores
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.recipe import recipe

SEED = 5


def divide(drive: Path, mine: Path, held_out: Path) -> None:
    """Copy the scans of a drive without labels, the last quarter to another folder."""
    files = find_scans(drive)
    for number, file in enumerate(files):
        folder = (mine if number < len(files) * 3 // 4 else held_out) / "velodyne"
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copy(file.path, folder)


def score(scans: Path, out: Path, truth: Path, weights: Path | None) -> str:
    """Predict scans, compare with the truth, and return accuracy and mean IoU as text."""
    predict_scans(scans, out, settings=NetworkSettings(weights))
    space = sn.label_space(truth / "labels.yaml")
    confusion = np.zeros((space.class_count, space.class_count), np.int64)
    labels = {file.stem: file.label_path for file in find_scans(truth)}
    for file in find_scans(scans):
        predicted = output_path(out, file.sequence, "predictions", file.stem)
        train_ids = space.to_train(sn.read_labels(labels[file.stem]))
        predicted_ids = space.to_train(sn.read_labels(predicted))
        confusion += confusion_matrix(train_ids, predicted_ids, space.class_count)
    result = scores(confusion, space)
    return f"accuracy {100 * result.accuracy:.1f} %, mean IoU {100 * result.iou_mean_present:.1f} %"


def main(
    folder: str, count: str = "4", scans: str = "24", plan: str = "finetune", weights: str = ""
) -> None:
    root, start = Path(folder), Path(weights) if weights else None
    drive, mine, held_out, picked = (
        root / name for name in ("drive", "mine", "held-out", "to-label")
    )
    synthesise(drive, train=1, valid=0, scans=int(scans), spacing=8.0, sensor="random", seed=SEED)
    divide(drive, mine, held_out)

    choice = pick(mine, picked, count=int(count), settings=NetworkSettings(start))
    print("picked", ", ".join(scan.scan for scan in choice.picked))

    truth = {file.stem: file.label_path for file in find_scans(drive)}
    edited = root / "edited"
    edited.mkdir(exist_ok=True)
    for scan in choice.picked:
        shutil.copy(truth[scan.scan], edited)
    import_labels(edited, picked)

    trained = train(picked, root / "run", recipe=recipe(plan), weights=start)
    if expected := trained.expected:
        print(f"estimated mean IoU {100 * expected.miou:.1f} %")
    print("before", score(held_out, root / "before", drive, start))
    print("after", score(held_out, root / "after", drive, trained.best))


if __name__ == "__main__":
    main(*sys.argv[1:])
