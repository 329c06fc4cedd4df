# SPDX-License-Identifier: MIT
"""Training on the fused labels of a drive without labels: scores before and after.

In each round the weights label the drive, and its scans vote (`fuse`). In a sample, a point has its
fused label with the probability that this label is right: 1 − the error, or the share of the votes
if they changed the label. The least probable `REJECTED_SHARE` of each class has no label, unless
its probability is above `CERTAIN`. Half of the samples are simulated scans of SCENES, which
`scene_pool` makes. Half of all samples are mixed with a scan of the other kind, in bands
(LaserMix), sectors or boxes. The running average of the weights is the teacher of the next round.

Each drive is the folder of a sequence, with `velodyne/`, `labels/` and maybe `poses.txt`. Its
labels are used for the scores alone; a label of several classes counts for each of them. Scores are
accuracy and mean IoU of the classes present, in %. They are written to FOLDER/NAME/scores.json
after every round, of single scans and fused.

Run: python -m benchmarks.studies.adaptation FOLDER SCENES DRIVE …
     [--label-space benchmarks/studies/nuscenes-five.yaml] [--classes benchmarks/studies/five.yaml]
     [--weights default] [--steps 500] [--rounds 2] [--set learning_rate=3e-4]
"""

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from benchmarks.commands import salsanext
from benchmarks.weights.scene_pool import KINDS, ScenePool
from salsanext_cli.commands.line.values.recipe_changes import read_overrides
from salsanext_cli.core.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.core.measures.scores import confusion_matrix, scores
from salsanext_cli.core.plain_data import Json
from salsanext_cli.core.records import Float
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.kitti import encode_bin
from salsanext_cli.io.formats.kitti_labels import encode_labels, read_labels
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.loading import load_network
from salsanext_cli.io.weights.weights import save_weights
from salsanext_cli.runs.fit.sensor_fit import fit_network
from salsanext_cli.runs.network_settings import weights_file
from salsanext_cli.runs.results.folder_names import DISAGREEMENT, ERROR, FUSED
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.selection import evenly_spaced
from salsanext_cli.training.data.augment import AnnotatedScan
from salsanext_cli.training.data.class_counts import class_weights, count_classes, rare_classes
from salsanext_cli.training.data.dataset import Samples, batches
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.initial_network import initial_network
from salsanext_cli.training.learner import Learner, fastest_precision
from salsanext_cli.training.recipe import Recipe, recipe

REJECTED_SHARE = 0.4
"""Share of the points of each class that have no label, unless they are certain."""
CERTAIN = 0.9
"""Probability of a right label from which on no point is rejected."""
COUNTED_SCANS = 32  # Simulated scans of each kind whose points of each class are counted
REPORTED_STEPS = 50  # Steps between two lines of the log
PROBABILITIES = "probabilities"  # Folder beside the labels of the drive in a round
CHANGES: Json = {"mix": 0.5, "also": 0.5, "folds": 0, "streets": 0}
"""Changes of the recipe `finetune`."""


@dataclass(frozen=True, kw_only=True)
class StudiedDrive:
    """Drive whose labels are used for its scores alone.

    Attributes
    ----------
    folder : Path
        Folder of its sequence.
    work : Path
        Folder for the files of the study.
    truth : LabelSpace
        Classes of its labels.
    classes : LabelSpace
        Classes of the scores, into which predicted labels are merged.
    """

    folder: Path
    work: Path
    truth: LabelSpace
    classes: LabelSpace

    def scans(self) -> Path:
        """Return a folder of links to the scans, with their labels beside it."""
        sequence = self.work / "data/sequences" / self.folder.name
        sequence.mkdir(parents=True, exist_ok=True)
        for name in ("velodyne", "labels"):
            if not (sequence / name).is_symlink():
                (sequence / name).symlink_to((self.folder / name).resolve())
        return sequence / "velodyne"

    def label(self, weights: Path, out: Path) -> None:
        """Label the scans in a folder, and fuse the labels in a folder in it."""
        words = ("--weights", weights, "--probabilities", "--error")
        salsanext("predict", self.scans(), out, *words)
        poses = self.folder / "poses.txt"
        pose_options = ("--poses", poses) if poses.exists() else ()
        salsanext("fuse", out, *pose_options)

    def predicted(self, out: Path, file: ScanFile) -> npt.NDArray[np.uint32]:
        """Return the raw ids of the labels of a scan in a folder, (N,)."""
        return read_labels(out / f"sequences/{file.sequence}/predictions/{file.stem}.label")

    def scores(self, out: Path) -> dict[str, float]:
        """Return accuracy, mean IoU and IoU of each class present in %, of labels in a folder."""
        size = self.classes.class_count
        confusion = np.zeros((size, size), np.int64)
        for file in find_scans(self.scans()):
            raw = read_labels(file.label_path) & np.uint32(0xFFFF)
            truth = self.truth.to_train(raw)
            predicted = self.classes.to_train(self.predicted(out, file))
            for merged, several in self.truth.alternatives.items():
                is_right = (raw == merged) & np.isin(predicted, several)
                predicted = np.where(is_right, truth, predicted)
            confusion += confusion_matrix(truth, predicted, size)
        result = scores(confusion, self.classes)
        values = {"accuracy": result.accuracy, "miou": result.iou_mean_present}
        values |= {score.name: score.iou for score in result.classes if score.points}
        return {name: round(100 * value, 2) for name, value in values.items()}


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbableLabels:
    """Fused labels of the points of a scan.

    Attributes
    ----------
    labels : (N,) uint8
        Train ids.
    probability : (N,) float32
        Probability that each label is right; 0 without a label.
    """

    labels: TrainIds
    probability: Float


def probable_labels(drive: StudiedDrive, out: Path, file: ScanFile) -> ProbableLabels:
    """Return the fused labels of a scan, of results of `predict` and `fuse` in a folder."""
    single = drive.predicted(out, file)
    fused = drive.predicted(out / FUSED, file)
    error = np.load(out / f"sequences/{file.sequence}/{ERROR}/{file.stem}.npy")
    against = np.load(out / FUSED / f"sequences/{file.sequence}/{DISAGREEMENT}/{file.stem}.npy")
    probability = 1 - np.where(fused == single, error, against)
    labels = label_space().to_train(fused)
    return ProbableLabels(
        labels=labels,
        probability=np.where(labels > 0, np.nan_to_num(probability), 0).astype(np.float32),
    )


def least_probabilities(scans: Sequence[ProbableLabels]) -> Float:
    """Return the probability below which labels of each class are rejected, (C,) float32."""
    labels = np.concatenate([scan.labels for scan in scans])
    probability = np.concatenate([scan.probability for scan in scans])
    least = np.full(label_space().class_count, CERTAIN, np.float32)
    for train_id in np.unique(labels):
        probability_of_class = probability[labels == train_id]
        least[train_id] = min(CERTAIN, np.quantile(probability_of_class, REJECTED_SHARE))
    return least


def write_probable_labels(drive: StudiedDrive, out: Path, target: Path) -> list[ScanFile]:
    """Write the labelled points of the drive with labels and probabilities as a data set."""
    files = find_scans(drive.scans())
    scans = [probable_labels(drive, out, file) for file in files]
    least = least_probabilities(scans)
    sequence = target / "sequences" / drive.folder.name
    (sequence / PROBABILITIES).mkdir(parents=True, exist_ok=True)
    labelled = 0
    for file, scan in zip(files, scans, strict=True):
        # Points of the vehicle have no label, so that no source removes points of these scans.
        chosen = np.flatnonzero(scan.labels)
        labels = scan.labels[chosen]
        probability = scan.probability[chosen]
        probability = np.where(probability < least[labels], np.float32(0), probability)
        points = encode_bin(read_scan(file.path).take(chosen))
        write_bytes(sequence / f"velodyne/{file.stem}.bin", points)
        raw = label_space().to_raw(labels)
        write_bytes(sequence / f"labels/{file.stem}.label", encode_labels(raw))
        np.save(sequence / PROBABILITIES / f"{file.stem}.npy", probability)
        labelled += int(np.count_nonzero(probability))
    total = sum(len(scan.labels) for scan in scans)
    print(f"{100 * labelled / total:.1f} % of the points have a label in samples", flush=True)
    return find_scans(target)


class ProbableSamples(Samples):
    """Samples of a drive with probable labels, the first source, and of simulated scans."""

    def _read(self, index: int, random: np.random.Generator) -> AnnotatedScan:
        """Read a scan; points of the drive have a label with its probability."""
        annotated = Samples._read(self, index, random)
        source, file = self.scan_at(index)
        if source is self.sources[0]:
            path = file.path.parents[1] / PROBABILITIES / f"{file.stem}.npy"
            is_drawn = random.random(len(annotated.labels), np.float32) < np.load(path)
            labels = np.where(is_drawn, annotated.labels, np.uint8(0))
            return replace(annotated, labels=labels)
        return annotated

    def _partner(self, index: int, random: np.random.Generator) -> AnnotatedScan:
        """Return a simulated scan for one of the drive, and the other way round."""
        count = len(self.sources[0].files)
        if index >= count:
            return self._read(int(random.integers(count)), random)
        return self._read(int(random.integers(count, sum(self.plan.scan_counts))), random)


def train_round(learner: Learner, samples: Samples, number: int) -> None:
    """Take the steps of a round, counted from 0."""
    steps = samples.plan.steps_per_epoch
    first = number * steps
    begun = time.monotonic()
    losses = []
    stream = batches(samples, first, workers=1)
    for step, (images, truth) in enumerate(islice(stream, steps), first):
        losses.append(float(learner.step(images, truth, step, steps)))
        if (step + 1) % REPORTED_STEPS == 0:
            seconds = time.monotonic() - begun
            loss = np.mean(losses[-REPORTED_STEPS:])
            print(f"step {step + 1}, loss {loss:.3f}, {seconds:.0f} s", flush=True)


def study(drive: StudiedDrive, pool: ScenePool, weights: Path, plan: Recipe) -> None:
    """Train on a drive in rounds; write and print the scores before and after each."""
    card = read_card(weights)
    module, _ = initial_network(weights, card.space, plan, card.sensor)
    simulated = [pool.source(kind) for kind in KINDS]
    points = np.zeros(card.space.class_count, np.int64)
    for source in simulated:
        counted = replace(source, files=evenly_spaced(source.files, COUNTED_SCANS))
        points += count_classes(counted).points.sum(axis=0)
    scored = card.space.scored
    weights_of_classes = class_weights(points, scored, plan.class_weight)
    learner = Learner(module, plan, weights_of_classes, torch.device("cpu"))
    fitted = fit_network(load_network(weights, "cpu"), drive.scans()).sensor
    rows: list[Json] = []
    teacher = weights
    for number in range(plan.epochs + 1):
        out = drive.work / f"round-{number}"
        drive.label(teacher, out)
        row = {"single": drive.scores(out), "fused": drive.scores(out / FUSED)}
        rows.append({"steps": number * plan.samples_per_epoch // plan.batch, **row})
        print(drive.folder.name, json.dumps(rows[-1]), flush=True)
        content = {
            "recipe": plan.to_dict(),
            "scans": len(find_scans(drive.scans())),
            "rounds": rows,
        }
        (drive.work / "scores.json").write_text(json.dumps(content, indent=1), "utf-8")
        if number == plan.epochs:
            break
        files = write_probable_labels(drive, out, drive.work / f"labels-{number}")
        drive_source = Source(
            files=files, space=label_space(), sensor=card.sensor, fitted={drive.folder.name: fitted}
        )
        samples = ProbableSamples(
            sources=[drive_source, *simulated],
            sensor=card.sensor,
            recipe=plan,
            rare=rare_classes(points, scored),
        )
        train_round(learner, samples, number)
        teacher = drive.work / f"round-{number + 1}.safetensors"
        save_weights(teacher, learner.average.eval(), replace(card, version=None), half=True)


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("drives", type=Path, nargs="+")
    parser.add_argument("--label-space", default="semantic-kitti")
    parser.add_argument("--classes", default="semantic-kitti")
    parser.add_argument("--weights", type=Path, default=Path("default"))
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    options = parser.parse_args(words or None)
    plan = recipe("finetune").with_changes(**CHANGES | read_overrides(options.set))
    plan = plan.with_changes(
        precision=fastest_precision(torch.device("cpu")),
        epochs=options.rounds,
        samples_per_epoch=options.steps // options.rounds * plan.batch,
    )
    weights = weights_file(options.weights)
    pool = ScenePool(options.scenes, read_card(weights).sensor)
    for folder in options.drives:
        drive = StudiedDrive(
            folder=folder,
            work=options.folder / folder.name,
            truth=label_space(options.label_space),
            classes=label_space(options.classes),
        )
        study(drive, pool, weights, plan)


if __name__ == "__main__":
    main()
