# SPDX-License-Identifier: MIT
"""Rebuild of the default weights: streets and sensors are simulated, PandaSet's scans are real.

PANDASET holds ``sequences/001`` and ``sequences/002``, each with velodyne/ and labels/: scans of
the Pandar64 of two drives, x forward, y left, z up, intensity / 255, and labels in raw ids of
SemanticKITTI (model-card.md has the map). The last ten of 002 are never trained on. PANDARGT
holds scans of the second sensor of both drives; those from the same time are never trained on
either. AACHEN holds ``sequences/a0`` and ``sequences/a1``, front sectors of a VLP-32C. The same
command continues an interrupted rebuild. What follows --train goes to `salsanext train`. With
--run nothing is trained: a training of `gpu_run.py` is finished.

Run: python benchmarks/default_weights.py pandaset/ folder/ [aachen/] [--pandargt pandargt/]
     [--streets 240] [--seed 0] [--run OUT | --train --weights default --set epochs=6]
"""

import argparse
import json
import math
import signal
import subprocess
import sys
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from pathlib import Path

import numpy as np
import torch
from commands import link
from corruption_models import LEVELS
from corruptions import SEVERITIES, write_data_set

from salsanext_cli.classes.label_space import label_space
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.fitting.label_scan import prepared_for
from salsanext_cli.fitting.scan_sample import ScanSample
from salsanext_cli.fitting.sensor_fit import fit_scans
from salsanext_cli.formats import read_scan
from salsanext_cli.network.card import WeightsCard, scan_digest
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.network.weights import read_weights, save_weights, save_with_card
from salsanext_cli.option_fields import ScanSelection
from salsanext_cli.parallel.network_task import network_pipeline
from salsanext_cli.results.paths import ScanFile, find_scans
from salsanext_cli.results.selection import data_set_label_space, evenly_spaced
from salsanext_cli.stages.tune import tune
from salsanext_cli.training.cross_validation import folds
from salsanext_cli.training.data.augment import rotate
from salsanext_cli.training.data.class_counts import class_shares
from salsanext_cli.training.data.sources import labelled_split
from salsanext_cli.training.tuning.error import FOLDS, JudgedPoints, cross_validated, judge_job
from salsanext_cli.training.tuning.int8 import int8_inputs
from salsanext_cli.training.tuning.scan_choice import labelled_scans
from salsanext_cli.training.tuning.scans import read_labelled_image

DRIVES = ("001", "002")
HELD_OUT = 10
"""Last scans of PandaSet, which are validated and which the temperature is fitted on too."""
VERSION = 5
"""Version of the weights that this script writes; raise it for each file that is published."""
STREETS_PER_VALIDATED = 4
"""Validation scans of the streets for each that every validation scores: ten of forty."""
SECTORS = 8
"""Sectors of 46° that fill a circle."""
POINTS_OF_SCAN = 10_000
"""Points of each validation scan that the model of errors is fitted to."""
CORRUPTIONS = 5
"""Copies of each validation sequence in bad conditions that the model of errors is fitted to."""
RANGED = 16
"""Training scans of each data set that the ranges for int8 are fitted to."""
SCANS_OF_STREET = 8
SIMULATED = "scenes simulated"
"""Figure of a training on a GPU: streets, each of as many scans."""
STREETS = ("--valid", "5", "--scans", SCANS_OF_STREET, "--spacing", "10", "--jobs", "2")

DESCRIPTION = (
    "Trained on simulated streets and sensors and on two drives of PandaSet: {simulated} scans "
    "of `salsanext synth`, half with an HDL-64 and half with random sensors, {real} of PandaSet "
    "(Hesai and Scale AI, CC BY 4.0).{aachen} See model-card.md; not for use on real roads."
)
AACHEN = (
    " Also {sectors} front sectors of one drive in Aachen (ika, RWTH Aachen, MIT), whose labels "
    "are from a network for camera images."
)


def salsanext(*words: str | int | Path) -> None:
    """Run a command of salsanext and stop where it fails."""
    print("salsanext", *words, flush=True)
    subprocess.run(["salsanext", *map(str, words)], check=True)


def split_pandaset(
    scans: Mapping[str, Sequence[ScanFile]],
) -> tuple[list[ScanFile], dict[str, list[ScanFile]]]:
    """Return the scans of PandaSet's sensors to train on, and the scans held out, by sensor.

    Sensors are ``pandaset``, whose last scans are held out, and perhaps ``pandargt``, whose scans
    from the same time are held out too. The name of each sequence begins with that of its sensor,
    so that every sensor is fitted to its own scans.
    """
    first = scans["pandaset"][-HELD_OUT:][0]
    training: list[ScanFile] = []
    held_out: dict[str, list[ScanFile]] = {name: [] for name in scans}
    for name, files in scans.items():
        for file in files:
            late = (file.sequence, file.stem) >= (first.sequence, first.stem)
            target = held_out[name] if late else training
            target.append(replace(file, sequence=f"{name}-{file.sequence}"))
    return training, held_out


def link_pandaset(roots: Mapping[str, Path], root: Path) -> list[ScanFile]:
    """Make a data set of links to the scans of `split_pandaset`; return those to train on."""
    scans = {name: find_scans(source, DRIVES) for name, source in roots.items()}
    training, held_out = split_pandaset(scans)
    for file in training:
        link(file, root / "sequences" / file.sequence)
    for name, files in held_out.items():
        for file in files:
            link(file, root / "sequences" / f"held-out-{name}")
    splits = {
        "train": sorted({file.sequence for file in training}),
        "valid": [f"held-out-{name}" for name, files in held_out.items() if files],
    }
    space = label_space(Path(__file__).parent / "pandaset.yaml").to_dict()
    (root / "labels.yaml").write_text(json.dumps(space | {"split": splits}))
    return training


def link_streets(streets: Path, real: Path, root: Path) -> None:
    """Make a data set of links to the streets that is validated on real scans, too."""
    space, training = labelled_split(streets, None, "train")
    for file in training:
        link(file, root / "sequences" / file.sequence)
    simulated = labelled_split(streets, None, "valid")[1][::STREETS_PER_VALIDATED]
    validated = [("valid-streets", file) for file in simulated]
    validated += [
        (f"valid-{file.sequence}", file) for file in labelled_split(real, None, "valid")[1]
    ]
    for name, file in validated:
        link(file, root / "sequences" / name)
    names = {"train": space.split("train"), "valid": sorted({name for name, _ in validated})}
    (root / "labels.yaml").write_text(json.dumps(space.to_dict() | {"split": names}))


def sectors_of(aachen: Path) -> list[ScanFile]:
    """Return the sectors to train on, as many as fill whole circles."""
    files = find_scans(aachen, ["a0", "a1"])
    return files[: len(files) // SECTORS * SECTORS]


def compose_circles(aachen: Path, root: Path) -> None:
    """Make a data set of full circles, each of sectors that lie far apart on the drive.

    A window of the image of a single sector would be empty, or for three quarters at least.
    """
    if (root / "labels.yaml").exists():
        return
    sequence = root / "sequences/train"
    for folder in ("velodyne", "labels"):
        (sequence / folder).mkdir(parents=True, exist_ok=True)
    files = sectors_of(aachen)
    circles = len(files) // SECTORS
    for circle in range(circles):
        points, labels = [], []
        for place, file in enumerate(files[circle::circles]):
            sector = np.fromfile(file.path, np.float32).reshape(-1, 4)
            sector[:, :3] = rotate(sector[:, :3], 2 * math.pi * place / SECTORS)
            points.append(sector)
            labels.append(np.fromfile(file.label_path, np.uint32))
        np.concatenate(points).tofile(sequence / f"velodyne/{circle:06}.bin")
        np.concatenate(labels).tofile(sequence / f"labels/{circle:06}.label")
    (root / "labels.yaml").write_bytes((Path(__file__).parent / "aachen.yaml").read_bytes())


def finish(
    run: Path,
    datasets: Sequence[Path],
    target: Path,
    description: str,
    sectors: Sequence[ScanFile] = (),
) -> None:
    """Write the last weights of a run in float16, without class weights, with a temperature.

    The temperature is the geometric mean of those fitted on the validation scans of the data sets.
    The weights know the sectors of the circles that they were trained on.
    """
    module, card = read_weights(run / "last.safetensors")
    remove_class_weights(module, card, run / "class_counts.json")
    digests = {scan_digest(read_scan(file.path, card.sensor)) for file in sectors}
    card = replace(
        card,
        description=description,
        temperature=1.0,
        error=None,  # What the training inherited is fitted anew.
        accuracy=None,
        trained_on=card.trained_on | digests,
        version=VERSION,
    )
    half = target.with_name("half.safetensors")
    save_weights(half, module, card, half=True)
    temperatures = []
    for dataset in datasets:
        tuned = half.with_name(f"{dataset.name}.safetensors")
        network = NetworkSettings(half, device="cpu")
        found = tune("temperature", dataset, tuned, settings=network, overwrite=True)
        temperatures.append(found["after"]["temperature"])
        print(f"temperature of {dataset.name}: {temperatures[-1]:.3f}", flush=True)
    temperature = float(np.exp(np.mean(np.log(temperatures))))
    save_with_card(half, target, replace(card, temperature=temperature))


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


def add_error(weights: Path, datasets: Sequence[Path]) -> None:
    """Add a model of errors on the validation scans, each sequence with its sensor fitted.

    Corrupted copies of them are among the scans that it is fitted to, so that it has seen scans
    that the network labels badly. It is without the height, so that it holds for sensors that are
    mounted otherwise.
    """
    settings = NetworkSettings(weights, device="cpu")
    network = settings.load()
    judged: dict[ScanFile, JudgedPoints] = {}
    parts: list[list[ScanFile]] = [[] for _ in range(FOLDS)]
    for dataset in datasets:
        scans, space = labelled_scans(dataset, ScanSelection(split="valid"), network.card)
        fold_of = {file.sequence: n for n, fold in enumerate(folds(scans, FOLDS)) for file in fold}
        scans += corrupted_copies(dataset, scans, weights.with_name("corrupted"))
        for (_, sequence), members in groupby(
            scans, lambda file: (file.path.parents[3], file.sequence)
        ):
            files = list(members)
            own = fit_scans(settings, network, ScanSample(files, network.sensor))
            read = partial(read_labelled_image, network=own, space=space)
            points = network_pipeline(judge_job(own, read, POINTS_OF_SCAN), own).results(files)
            judged |= zip(files, points, strict=True)
            parts[fold_of[sequence]] += files
    model = cross_validated(judged, parts)
    roots = {dataset.name for dataset in datasets}
    parents = {(file.path.parents[3].name, file.sequence) for file in judged}
    names = sorted(f"{root}/{sequence}" for root, sequence in parents if root in roots)
    own = {"sequences": names, "fitted_to": "simulated scans only, most in bad conditions"}
    model = replace(model, scores={**model.scores, **own})
    print("errors:", model.scores, flush=True)
    save_with_card(weights, weights, replace(network.card, error=model))


def add_int8(weights: Path, datasets: Sequence[Path]) -> None:
    """Add the ranges for int8, fitted to scans of each data set that was trained on."""
    settings = NetworkSettings(weights, device="cpu")
    network, inputs = settings.load(), []
    for dataset in datasets:
        files = labelled_split(dataset, None, "train")[1]
        for file in evenly_spaced(files, RANGED):
            fitted = fit_scans(settings, network, ScanSample([file], network.sensor))
            inputs.append(prepared_for(fitted, file).input)
    card = replace(network.card, int8=int8_inputs(network.module, inputs))
    save_with_card(weights, weights, card)


def simulated_scans(run: Path) -> int:
    """Return the number of scans that a run of `gpu_run.py` simulated."""
    figures = json.loads((run / "report.json").read_text())["parts"]["train"]["figures"]
    scenes = next(row["value"] for row in figures if row["name"] == SIMULATED)
    return int(scenes) * SCANS_OF_STREET


def main() -> None:
    parser = argparse.ArgumentParser()
    for name in ("pandaset", "folder"):
        parser.add_argument(name, type=Path)
    parser.add_argument("aachen", type=Path, nargs="?")
    parser.add_argument("--pandargt", type=Path, help="scans of PandaSet's second sensor")
    text = "streets of each data set to train on (%(default)s)"
    parser.add_argument("--streets", type=int, default=240, help=text)
    text = "seed of the streets; the next one is that of the random sensors' (%(default)s)"
    parser.add_argument("--seed", type=int, default=0, help=text)
    parser.add_argument("--run", type=Path, help="results of gpu_run.py to finish")
    parser.add_argument("--train", nargs=argparse.REMAINDER, default=[])
    given = parser.parse_args()
    # The command that runs ends with this script.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    out: Path = given.folder
    streets, sensors, real = (out / name for name in ("streets", "sensors", "pandaset"))
    simulated = ("--train", given.streets, *STREETS)
    salsanext("synth", streets, *simulated, "--seed", given.seed)
    salsanext("synth", sensors, *simulated, "--seed", given.seed + 1, "--sensor", "random")
    roots = {"pandaset": given.pandaset, "pandargt": given.pandargt}
    scans = link_pandaset({name: root for name, root in roots.items() if root}, real)
    link_streets(streets, real, out / "validated")
    also, sectors = [sensors, real], []
    if given.aachen:
        sectors = sectors_of(given.aachen)
        compose_circles(given.aachen, out / "aachen")
        also.append(out / "aachen")
    run: Path = given.run or out / "run"
    if not given.run:
        how = [word for dataset in also for word in ("--also", dataset)]
        how += ["--recipe", "street", "--sensor", "hdl64-512", *given.train]
        salsanext("train", out / "validated", run, *how)
    description = DESCRIPTION.format(
        simulated=simulated_scans(run) if given.run else 2 * given.streets * SCANS_OF_STREET,
        real=len(scans),
        aachen=AACHEN.format(sectors=len(sectors)) if sectors else "",
    )
    finish(run, (streets, real), out / "default.safetensors", description, sectors)
    add_error(out / "default.safetensors", (streets, sensors))
    add_int8(out / "default.safetensors", (streets, sensors, real))


if __name__ == "__main__":
    main()
