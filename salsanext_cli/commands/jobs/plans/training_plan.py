# SPDX-License-Identifier: MIT
"""Plan of a training: its scans, classes, steps and files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.sensors.sensor import NOISE, Sensor
from salsanext_cli.core.texts import counted, first_few
from salsanext_cli.io.weights.weights import encode_weights
from salsanext_cli.runs.fit.scan_sample import MAX_SCANS
from salsanext_cli.runs.scans.selection import evenly_spaced
from salsanext_cli.training.checkpoint import finished_epochs
from salsanext_cli.training.cross_validation import held_out
from salsanext_cli.training.data.class_counts import count_classes, require_scored
from salsanext_cli.training.data.dataset import SamplingPlan
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.run_folder import CHECKPOINT, recorded_settings


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingPlan:
    """What a training would do.

    Attributes
    ----------
    training, validation, further, simulated : int
        Number of scans for training and validation, of further data sets, and to simulate.
    sampled : int
        Number of training scans, evenly spaced, whose classes were counted.
    points : mapping of str to int
        Number of their points by scored class.
    sensor : Sensor
        Sensor of the images.
    steps : int
        Steps of an epoch.
    epochs, done : int
        Number of all epochs, and of finished ones; with folds, of the training on all scans.
    folds : int
        Number of trainings of the cross-validation, each with at most `epochs` epochs.
    size : int
        Estimated size of weights and checkpoints in the run folder, in bytes.
    """

    training: int
    validation: int
    further: int
    simulated: int
    sampled: int
    points: Mapping[str, int]
    sensor: Sensor
    steps: int
    epochs: int
    done: int
    folds: int
    size: int

    @classmethod
    def from_sources(
        cls,
        run: Path,
        sources: Sequence[Source],
        sampling: SamplingPlan,
        network: SegmentationNetwork,
        card: WeightsCard,
        *,
        scenes: int,
        overwrite: bool,
    ) -> "TrainingPlan":
        """Return the plan of a training; some of its scans are read.

        Parameters
        ----------
        run : Path
            Run folder.
        sources : sequence of Source
            Training scans, validation scans, and scans of further data sets.
        sampling : SamplingPlan
            Order of all samples.
        network : SegmentationNetwork
            Network before training.
        card : WeightsCard
            Its description.
        scenes : int
            Number of simulated scans.
        overwrite : bool
            Whether the training starts again.

        Raises
        ------
        SalsanextError
            If the scans cannot be read, or contain no scored class.
        """
        training, validation, *further = sources
        recipe = sampling.recipe
        sampled = _sample(training)
        points = _points(sampled, is_whole=len(sampled.files) == len(training.files))
        if validation.files:
            validated = replace(
                validation, files=evenly_spaced(validation.files, recipe.validation_scans)
            )
            sample = _sample(validated)
            _points(sample, is_whole=len(sample.files) == len(validated.files))
        folds = 0 if validation.files else len(held_out(training.files, recipe.folds))
        training_bytes = 2 * len(encode_weights(network, card)) + _checkpoint_bytes(network, recipe)
        return cls(
            training=len(training.files),
            validation=len(validation.files),
            further=sum(len(source.files) for source in further),
            simulated=scenes,
            sampled=len(sampled.files),
            points=points,
            sensor=card.sensor,
            steps=sampling.steps_per_epoch,
            epochs=recipe.epochs,
            done=0 if overwrite else _finished_epochs(run),
            folds=folds,
            size=(folds + 1) * training_bytes,
        )

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {
            "dry_run": True,
            "training": self.training,
            "validation": self.validation,
            "further": self.further,
            "simulated": self.simulated,
            "sampled": self.sampled,
            "points": dict(self.points),
            "steps": self.steps,
            "epochs": self.epochs,
            "complete": self.done,
            "folds": self.folds,
            "bytes": self.size,
            "sensor": self.sensor.to_dict(NOISE),
        }

    def lines(self) -> list[str]:
        """Return lines that state what the training would do."""
        scans = f"{counted(self.training, 'scan')} for training, {self.validation:,} for validation"
        if self.further:
            scans += f", {self.further:,} of further data sets"
        if self.simulated:
            scans += f", {self.simulated:,} simulated"
        absent = [name for name, count in self.points.items() if not count]
        present = len(self.points) - len(absent)
        classes = f"{present} of {len(self.points)}"
        if absent:
            classes += f", without {first_few(absent)}"
        steps = f"{counted(self.epochs, 'epoch')} of {counted(self.steps, 'step')}"
        epochs = f"{steps}, {self.done:,} done already"
        if self.folds:
            epochs_of_fold = counted(self.epochs, "epoch")
            folds = f"{counted(self.folds, 'fold')} of at most {epochs_of_fold} each"
            epochs = f"at most {epochs}, after {folds}"
        return [scans, f"scored classes in {counted(self.sampled, 'scan')}: {classes}", epochs]


def _sample(source: Source) -> Source:
    """Return up to 16 scans of a source, evenly spaced."""
    return replace(source, files=evenly_spaced(source.files, MAX_SCANS))


def _points(source: Source, *, is_whole: bool) -> dict[str, int]:
    """Count the points of the scored classes; refuse whole data sets without any."""
    space = source.space
    counted_scans = count_classes(source)
    if is_whole:
        require_scored(space, source.files, counted_scans.points)
    points = counted_scans.points.sum(axis=0)
    names = zip(space.names, points.tolist(), space.scored, strict=True)
    return {name: count for name, count, is_scored in names if is_scored}


def _checkpoint_bytes(network: SegmentationNetwork, recipe: Recipe) -> int:
    """Return the size of a checkpoint: the network, its average, and the optimiser's state."""
    weights = sum(tensor.nbytes for tensor in network.state_dict().values())
    parameters = sum(parameter.nbytes for parameter in network.parameters())
    moments = 2 if recipe.optimiser == "adamw" else 1
    return (2 if recipe.average else 1) * weights + moments * parameters


def _finished_epochs(run: Path) -> int:
    """Return the number of epochs after which the training in a folder goes on."""
    checkpoint = run / CHECKPOINT
    if recorded_settings(run) is None or not checkpoint.exists():
        return 0
    return finished_epochs(checkpoint)
