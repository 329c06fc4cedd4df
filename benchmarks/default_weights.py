# SPDX-License-Identifier: MIT
"""Rebuild of the default weights: streets and sensors are simulated, PandaSet's scans are real.

PANDASET is a folder ``sequences/002`` with velodyne/ and labels/: every second scan of the
Pandar64 of that sequence, x forward, y left, z up, intensity / 255, and labels in raw ids of
SemanticKITTI (docs/model-card.md has the map). The last ten are never trained on. The training
has two rounds, the second of which begins with the weights of the first. An interrupted rebuild
goes on where it was.

Run: python benchmarks/default_weights.py pandaset/ folder/
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
import torch

from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.fitting.scan_fit import fitted
from salsanext_cli.network.weights import read_weights, save_weights, save_with_card
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.stages.tune_temperature import tune_temperature
from salsanext_cli.training.cross_validation import folds
from salsanext_cli.training.data.class_counts import class_shares
from salsanext_cli.training.tuning.error import FOLDS, cross_validated
from salsanext_cli.training.tuning.judged_points import JudgedPoints, judged_points
from salsanext_cli.training.tuning.labelled_images import VALIDATION, labelled_scans

HELD_OUT = 10
"""Scans of PandaSet that the temperature is fitted on too, and that are scored."""
POINTS_OF_SCAN = 10_000
"""Points of each validation scan that the model of errors is fitted to."""
STREETS = ("--train", "120", "--valid", "5", "--scans", "8", "--spacing", "10", "--jobs", "2")

DESCRIPTION = (
    "Trained on simulated streets and sensors and on one drive of PandaSet: 960 scans each of "
    "`salsanext synth` with an HDL-64 and with random sensors, 28 of PandaSet (Hesai and Scale AI, "
    "CC BY 4.0). The error is fitted to simulated scans only. See docs/model-card.md; not for use "
    "on real roads."
)


def salsanext(*words: str | Path) -> None:
    """Run a command of salsanext and stop where it fails."""
    print("salsanext", *words, flush=True)
    subprocess.run(["salsanext", *map(str, words)], check=True)


def link_pandaset(source: Path, root: Path) -> None:
    """Make a data set of links to the scans, in two sequences."""
    scans = sorted((source / "sequences/002/velodyne").glob("*.bin"))
    splits = {"train": scans[:-HELD_OUT], "held-out": scans[-HELD_OUT:]}
    for name, members in splits.items():
        for scan in members:
            label = scan.parent.parent / "labels" / f"{scan.stem}.label"
            for file in (scan, label):
                link = root / "sequences" / name / file.parent.name / file.name
                link.parent.mkdir(parents=True, exist_ok=True)
                if not link.is_symlink():
                    link.symlink_to(file.resolve())
    (root / "labels.yaml").write_bytes((Path(__file__).parent / "pandaset.yaml").read_bytes())


def finish(run: Path, datasets: Sequence[Path], target: Path) -> None:
    """Write the last weights of a run in float16, without class weights, with a temperature.

    A loss weighted by f^-a, f being the share of a class, makes the softmax that of a world where
    every class is f^-a times as frequent; a·log f added to the logits takes that back. The
    temperature is the geometric mean of those fitted on the validation scans of the data sets.
    """
    module, card = read_weights(run / "last.safetensors")
    points = json.loads((run / "class_counts.json").read_text())["points"]
    counts = np.array([points[name] for name in card.space.names])
    shares = class_shares(counts, card.space.scored)
    exponents = np.where(shares > 0, card.recipe["class_weight"], 0)
    added = exponents * np.log(np.where(shares > 0, shares, 1))
    state = module.state_dict()
    state["logits.bias"] += torch.from_numpy(added.astype(np.float32))
    module.load_state_dict(state)
    card = replace(card, description=DESCRIPTION, temperature=1.0)
    half = target.with_name("half.safetensors")
    save_weights(half, module, card, half=True)
    temperatures = []
    for dataset in datasets:
        tuned = half.with_name(f"{dataset.name}.safetensors")
        network = NetworkSettings(half, device="cpu")
        found = tune_temperature(dataset, tuned, network=network, overwrite=True)
        temperatures.append(found["after"]["temperature"])
        print(f"temperature of {dataset.name}: {temperatures[-1]:.3f}", flush=True)
    temperature = float(np.exp(np.mean(np.log(temperatures))))
    save_with_card(half, target, replace(card, temperature=temperature))


def add_error(weights: Path, datasets: Sequence[Path]) -> None:
    """Add a model of errors on the validation scans, each sequence with its sensor fitted.

    It is without the height, so that it holds for sensors that are mounted otherwise.
    """
    settings = NetworkSettings(weights, device="cpu")
    network = settings.load()
    judged: dict[ScanFile, JudgedPoints] = {}
    for dataset in datasets:
        scans, space = labelled_scans(dataset, VALIDATION, network.card)
        for _, members in groupby(scans, lambda file: file.sequence):
            files = list(members)
            own = fitted(settings, network, files)
            judged |= {file: judged_points(file, own, space, POINTS_OF_SCAN) for file in files}
    model = cross_validated(judged, folds(list(judged), FOLDS), height=False)
    names = sorted({f"{file.path.parents[3].name}/{file.sequence}" for file in judged})
    model = replace(model, scores=dict(model.scores) | {"sequences": names})
    print("errors:", model.scores, flush=True)
    save_with_card(weights, weights, replace(network.card, error=model, description=DESCRIPTION))


def main() -> None:
    pandaset, out = map(Path, sys.argv[1:3])
    streets, sensors, real = (out / name for name in ("streets", "sensors", "pandaset"))
    runs = [out / "run-1", out / "run-2"]
    if not (streets / "labels.yaml").exists():
        salsanext("synth", streets, *STREETS, "--seed", "0", "--overwrite")
    if not (sensors / "labels.yaml").exists():
        salsanext("synth", sensors, *STREETS, "--seed", "1", "--sensor", "random", "--overwrite")
    link_pandaset(pandaset, real)
    how = ("--also", sensors, "--also", real, "--recipe", "street", "--sensor", "hdl64-512")
    salsanext("train", streets, runs[0], *how)
    salsanext("train", streets, runs[1], *how, "--weights", runs[0] / "last.safetensors")
    finish(runs[1], (streets, real), out / "default.safetensors")
    add_error(out / "default.safetensors", (streets, sensors))


if __name__ == "__main__":
    main()
