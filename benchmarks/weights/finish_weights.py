# SPDX-License-Identifier: MIT
"""Parts of weights that are fitted after a training: temperatures, error models, int8 ranges.

Temperatures and error models are fitted at each width that the weights were trained with. As a
command, it finishes the running average that `background_training.py --write` has written.

Run: python -m benchmarks.weights.finish_weights AVERAGE WEIGHTS_OUT --description TEXT
     --temperature DATASET… --error DATASET… --int8 DATASET…
"""

import argparse
import json
import zlib
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from pathlib import Path

import numpy as np
import torch

from benchmarks.studies.corruption_models import LEVELS
from benchmarks.studies.corruptions import SEVERITIES, write_data_set
from salsanext_cli.commands.stages.tune import tune_temperature
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import read_weights, save_weights, save_with_card
from salsanext_cli.runs.fit.scan_reading import read_prepared
from salsanext_cli.runs.fit.scan_sample import sample_of_files
from salsanext_cli.runs.fit.sensor_fit import fit_scans
from salsanext_cli.runs.loop.network_task import network_pipeline
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import data_set_label_space, evenly_spaced
from salsanext_cli.training.cross_validation import folds
from salsanext_cli.training.data.class_counts import class_shares
from salsanext_cli.training.data.sources import labelled_split
from salsanext_cli.training.tuning.error import FOLDS, cross_validated, judge_job
from salsanext_cli.training.tuning.error_training import JudgedPoints
from salsanext_cli.training.tuning.int8 import int8_inputs
from salsanext_cli.training.tuning.scan_choice import labelled_scans
from salsanext_cli.training.tuning.scans import read_labelled_image

VERSION = 6
"""Version of the published weights; raise it for each file that is published."""
POINTS_OF_SCAN = 10_000
"""Points of each validation scan that the model of errors is fitted to."""
CORRUPTIONS = 5
"""Copies of each validation sequence in bad conditions that the model of errors is fitted to."""
RANGED = 16
"""Training scans of each data set that the ranges for int8 are fitted to."""


def published_card(card: WeightsCard, description: str) -> WeightsCard:
    """Return the card of weights that are published, without the parts that are fitted anew."""
    return replace(
        card,
        description=description,
        temperature=1.0,
        error=None,
        accuracy=None,
        int8={},
        risk=None,
        parts_of_widths={},
        version=VERSION,
    )


def at_width(weights: Path, width: int) -> NetworkSettings:
    return NetworkSettings(weights, device="cpu", width=width)


def add_temperatures(weights: Path, target: Path, datasets: Sequence[Path]) -> None:
    """Write weights with a temperature at each width.

    It is the geometric mean of those fitted on the validation scans of the data sets.
    """
    card = read_card(weights)
    for width in card.trained_widths:
        temperatures = []
        for dataset in datasets:
            tuned = target.with_name(f"{dataset.name}.safetensors")
            report = tune_temperature(
                dataset, tuned, settings=at_width(weights, width), overwrite=True
            )
            temperatures.append(report.fit.after.temperature)
            print(f"temperature of {dataset.name} at {width}: {temperatures[-1]:.3f}", flush=True)
        temperature = float(np.exp(np.mean(np.log(temperatures))))
        card = replace(card.at_width(width), temperature=temperature)
    save_with_card(weights, target, card)


def remove_class_weights(module: SegmentationNetwork, card: WeightsCard, counts: Path) -> None:
    """Add to the logits what takes back the class weights of the loss.

    A loss weighted by f^-a, f being the share of a class, makes the softmax that of a world where
    every class is f^-a times as frequent; a·log f added to the logits takes that back. `counts` is
    the file of the points of each class in training.
    """
    points = json.loads(counts.read_text())["points"]
    of_classes = np.array([points[name] for name in card.space.names])
    shares = class_shares(of_classes, card.space.scored)
    exponents = np.where(shares > 0, card.recipe["class_weight"], 0)
    added = exponents * np.log(np.where(shares > 0, shares, 1))
    state = module.state_dict()
    state["logits.bias"] += torch.from_numpy(added.astype(np.float32))
    module.load_state_dict(state)


def corrupted_copies(dataset: Path, files: Sequence[ScanFile], folder: Path) -> list[ScanFile]:
    """Write `CORRUPTIONS` copies of each sequence, each in other bad conditions, and list them."""
    space = data_set_label_space(dataset) or label_space()
    conditions = [(kind, severity) for kind in LEVELS for severity in SEVERITIES]
    copies: list[ScanFile] = []
    for sequence, members in groupby(files, lambda file: file.sequence):
        scans = list(members)
        rng = np.random.default_rng(zlib.crc32(f"{dataset.name}/{sequence}".encode()))
        for number in rng.choice(len(conditions), CORRUPTIONS, replace=False):
            kind, severity = conditions[number]
            root = folder / f"{dataset.name} {kind} {severity}"
            write_data_set(root, space, scans, kind, severity, 0)
            copies += find_scans(root, [sequence])
    return copies


def add_error_models(weights: Path, datasets: Sequence[Path]) -> None:
    """Add a model of errors on the validation scans at each width.

    Corrupted copies of them are among the scans that it is fitted to, so that it has seen scans
    that the network labels badly. It is without the height, so that it holds for sensors that are
    mounted otherwise.
    """
    card = read_card(weights)
    copies: dict[Path, list[ScanFile]] = {}
    for dataset in datasets:
        scans = labelled_scans(dataset, ScanSelection(split="valid"), card).files
        copies[dataset] = corrupted_copies(dataset, scans, weights.with_name("corrupted"))
    for width in card.trained_widths:
        settings = at_width(weights, width)
        network = settings.load()
        model = error_model(settings, network, copies)
        print(f"errors at {width}:", model.scores, flush=True)
        save_with_card(weights, weights, replace(network.card, error=model))


def error_model(
    settings: NetworkSettings, network: Network, copies: dict[Path, list[ScanFile]]
) -> ErrorModel:
    """Return a model of errors, each sequence with its sensor fitted; copies by their data set."""
    judged: dict[ScanFile, JudgedPoints] = {}
    parts: list[list[ScanFile]] = [[] for _ in range(FOLDS)]
    for dataset, corrupted in copies.items():
        labelled = labelled_scans(dataset, ScanSelection(split="valid"), network.card)
        scans = labelled.files
        fold_of = {file.sequence: n for n, fold in enumerate(folds(scans, FOLDS)) for file in fold}
        for (_, sequence), members in groupby(
            [*scans, *corrupted], lambda file: (file.path.parents[3], file.sequence)
        ):
            files = list(members)
            own = fit_scans(settings, network, sample_of_files(files, network.sensor))
            read = partial(read_labelled_image, network=own, space=labelled.space)
            points = network_pipeline(judge_job(own, read, POINTS_OF_SCAN), own).results(files)
            judged |= zip(files, points, strict=True)
            parts[fold_of[sequence]] += files
    model = cross_validated(judged, parts).model
    roots = {dataset.name for dataset in copies}
    parents = {(file.path.parents[3].name, file.sequence) for file in judged}
    names = sorted(f"{root}/{sequence}" for root, sequence in parents if root in roots)
    own_scores = {"sequences": names, "fitted_to": "simulated scans only, most in bad conditions"}
    return replace(model, scores={**model.scores, **own_scores})


def add_int8(weights: Path, datasets: Sequence[Path]) -> None:
    """Add the ranges for int8, fitted to scans of each data set that was trained on."""
    settings = NetworkSettings(weights, device="cpu")
    network, inputs = settings.load(), []
    for dataset in datasets:
        files = labelled_split(dataset, None, "train")[1]
        for file in evenly_spaced(files, RANGED):
            fitted = fit_scans(settings, network, sample_of_files([file], network.sensor))
            inputs.append(read_prepared(file, fitted).scan.input)
    card = replace(network.card, int8=int8_inputs(network.module, inputs))
    save_with_card(weights, weights, card)


def main() -> None:
    parser = argparse.ArgumentParser()
    for name in ("average", "target"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--description", required=True)
    for name in ("--temperature", "--error", "--int8"):
        parser.add_argument(name, type=Path, nargs="+", required=True)
    given = parser.parse_args()
    module, card = read_weights(given.average)
    bare = given.target.with_name("bare.safetensors")
    save_weights(bare, module, published_card(card, given.description), half=True)
    add_temperatures(bare, given.target, given.temperature)
    add_error_models(given.target, given.error)
    add_int8(given.target, given.int8)


if __name__ == "__main__":
    main()
