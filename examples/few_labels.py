# SPDX-License-Identifier: MIT
"""From scans of another sensor to labels of one's own: pick, label, train, predict.

A synthetic drive through a sensor that the weights have not seen stands for one's own scans. Its
last quarter is kept aside. Of the others some are picked, and the truth takes the place of the
person.

Run: python examples/few_labels.py folder/ [4 24 finetune weights.safetensors]
"""

import shutil
import sys
from pathlib import Path

import numpy as np

import salsanext_cli as sn
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.measures.scores import confusion_matrix, scores
from salsanext_cli.results.paths import find_scans, output_path
from salsanext_cli.stages.import_labels import import_labels
from salsanext_cli.stages.pick import pick
from salsanext_cli.stages.predict import predict_scans
from salsanext_cli.stages.synth import synthesise
from salsanext_cli.stages.train import train
from salsanext_cli.training.recipe import recipe

SEED = 5


def divide(drive: Path, mine: Path, aside: Path) -> None:
    """Copy the scans of a drive without their labels, the last quarter to another folder."""
    files = find_scans(drive)
    for number, file in enumerate(files):
        folder = (mine if number < len(files) * 3 // 4 else aside) / "velodyne"
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
        pair = (space.to_train(sn.read_labels(path)) for path in (labels[file.stem], predicted))
        confusion += confusion_matrix(*pair, space.class_count)
    found = scores(confusion, space)
    return f"accuracy {100 * found.accuracy:.1f} %, mean IoU {100 * found.iou_mean_present:.1f} %"


def main(
    folder: str, count: str = "4", scans: str = "24", plan: str = "finetune", weights: str = ""
) -> None:
    root, start = Path(folder), Path(weights) if weights else None
    drive, mine, aside, picked = (root / name for name in ("drive", "mine", "aside", "to-label"))
    synthesise(drive, train=1, valid=0, scans=int(scans), spacing=8.0, sensor="random", seed=SEED)
    divide(drive, mine, aside)

    choice = pick(mine, picked, count=int(count), settings=NetworkSettings(start))
    print("picked", ", ".join(each.scan for each in choice.picked))

    truth = {file.stem: file.label_path for file in find_scans(drive)}
    edited = root / "edited"
    edited.mkdir(exist_ok=True)
    for each in choice.picked:
        shutil.copy(truth[each.scan], edited)
    import_labels(edited, picked)

    trained = train(picked, root / "run", recipe=recipe(plan), weights=start)
    if expected := trained.expected:
        print(f"expect mean IoU {100 * expected.miou:.1f} %")
    print("before", score(aside, root / "before", drive, start))
    print("after", score(aside, root / "after", drive, trained.best))


if __name__ == "__main__":
    main(*sys.argv[1:])
