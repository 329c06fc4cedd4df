# SPDX-License-Identifier: MIT
"""Data sets to train on: labelled scans, their label space and the sensors that recorded them."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path

import joblib
import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.classes.merging import ClassMerging, is_merged
from salsanext_cli.core.errors import LabelError, NoInputError
from salsanext_cli.core.fitting.field_of_view import fit_view
from salsanext_cli.core.geometry.intensity import on_other_scale
from salsanext_cli.core.geometry.network_input import with_image_statistics
from salsanext_cli.core.geometry.projection import project
from salsanext_cli.core.geometry.sensor_frame import ego_points, in_sensor_frame
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.records import Float
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted, first_few
from salsanext_cli.core.wording import setting
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.runs.annotation.label_records import pre_labelled_scans
from salsanext_cli.runs.annotation.las_classification import (
    classified_scans,
    labels_source,
    read_scan_labels,
)
from salsanext_cli.runs.fit.scan_sample import sample_of_files
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.selection import data_set_label_space, log_unused, with_splits
from salsanext_cli.training.data.augment import AnnotatedScan
from salsanext_cli.training.data.targets import ClassSets, to_targets

SPLITS_ARE_NAMED = "labels.yaml in the data set names the sequences of each split"

log = logging.getLogger(__name__)


def read_labelled(
    file: ScanFile, space: LabelSpace, sensor: Sensor, sets: ClassSets = ()
) -> AnnotatedScan:
    """Read a scan and the targets of its points, (N,) uint8: train ids if there are no sets."""
    scan = read_scan(file.path, sensor)
    raw = read_scan_labels(file, space, scan)
    return AnnotatedScan(scan, to_targets(raw, space, sets, labels_source(file)))


def without_vehicle(annotated: AnnotatedScan, sensor: Sensor) -> AnnotatedScan:
    """Return a scan in the frame of its sensor, without points on the sensor or its vehicle.

    Parameters
    ----------
    annotated : AnnotatedScan
        N points in the frame of their file, and their targets.
    sensor : Sensor
        Sensor, or sensors, of such scans.

    Returns
    -------
    AnnotatedScan
        The other points, in metres, and their targets.
    """
    scan = in_sensor_frame(annotated.scan, sensor_of(annotated.scan, sensor))
    ego = ego_points(scan.points, sensor)
    if not len(ego):
        return AnnotatedScan(scan, annotated.labels)
    others = np.delete(np.arange(len(scan)), ego)
    return AnnotatedScan(scan.take(others), annotated.labels[others])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Source:
    """Labelled scans of one data set, their label space and sensor.

    `sensor` is the sensor that the network is trained for. `fitted` holds the sensors fitted to the
    sequences, as `predict` does; it is empty if `sensor` describes all scans. Scans are `simulated`
    if `train` made them, so that the user cannot correct them.
    """

    files: Sequence[ScanFile]
    space: LabelSpace
    sensor: Sensor
    fitted: Mapping[str, Sensor] = field(default_factory=dict)
    simulated: bool = False

    def sensor_of(self, file: ScanFile) -> Sensor:
        """Return the sensor for the projection of a scan."""
        return self.fitted.get(file.sequence, self.sensor)

    def at_width(self, width: int) -> "Source":
        """Return the scans for images of another width, in columns."""
        fitted = {name: sensor.resized(width=width) for name, sensor in self.fitted.items()}
        return replace(self, sensor=self.sensor.resized(width=width), fitted=fitted)

    def read(self, file: ScanFile, sets: ClassSets) -> AnnotatedScan:
        """Read a scan without the vehicle's points, in the sensor frame, and its targets, (N,)."""
        sensor = self.sensor_of(file)
        annotated = without_vehicle(read_labelled(file, self.space, sensor, sets), sensor)
        scan = annotated.scan
        quantiles = sensor.intensity_quantiles
        trained = self.sensor.intensity_quantiles
        if quantiles and trained and quantiles != trained:
            scan = replace(scan, intensity=on_other_scale(scan.intensity, quantiles, trained))
        return AnnotatedScan(scan, annotated.labels)


def training_sources(sources: Sequence[Source], *, fit: bool, jobs: int = 1) -> list[Source]:
    """Return sources with intensity and gaps of the first, and fitted sequences if wanted."""
    if fit:
        sources = [fitted_source(source, jobs) for source in sources]
    first = sources[0]
    if fit and first.sensor.intensity_quantiles:
        # The sequences were fitted to the intensity of the initial weights.
        return list(sources)

    def image_of(file: ScanFile) -> Float:
        sensor = first.sensor_of(file)
        scan = read_scan(file.path, sensor)
        return project(scan, sensor_of(scan, sensor)).channels

    images = sample_of_files(first.files, first.sensor, image_of).images(first.sensor)
    sensor = with_image_statistics(first.sensor, images)
    return [replace(source, sensor=sensor) for source in sources]


def fitted_source(source: Source, jobs: int = 1) -> Source:
    """Return a source with the sensor of each sequence fitted to its scans, as `predict` does."""
    sequences = {name: list(files) for name, files in groupby(source.files, lambda f: f.sequence)}

    def fit(files: Sequence[ScanFile]) -> Sensor:
        scans = sample_of_files(files, source.sensor).scans
        sensor = fit_view(scans, source.sensor)
        images = [project(scan, sensor_of(scan, sensor)).channels for scan in scans]
        return with_image_statistics(sensor, images)

    run = joblib.Parallel(jobs, backend="threading")
    sensors = run(joblib.delayed(fit)(files) for files in sequences.values())
    return replace(source, fitted=dict(zip(sequences, sensors, strict=True)))


def further_source(dataset: Path, space: LabelSpace, sensor: Sensor) -> Source:
    """Return the training split of a further data set, its classes merged into those of a space."""
    further, files = labelled_split(dataset, None, "train")
    classes = merged_into(further, space)
    if classes is None:
        problem = f"has other classes ({first_few(further.differences(space))})"
        raise LabelError(dataset, problem, f"classes of {space.name}")
    return Source(files=files, space=classes, sensor=sensor)


def merged_into(further: LabelSpace, space: LabelSpace) -> LabelSpace | None:
    """Return a label space with the classes of another, None if they do not merge into these."""
    if is_merged(space, further):
        # The first data set may distinguish other classes than this one.
        further = ClassMerging.between(further, replace(space, splits={}, alternatives={})).space
    return further if further.fits(space) else None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ScansToTrainOn:
    """Labelled scans of a data set for a training."""

    space: LabelSpace  # Classes of the labels, with splits
    training: list[ScanFile]
    validation: list[ScanFile]  # Empty if the training scans are cross-validated


def scans_to_train_on(
    dataset: Path, space: LabelSpace | None, *, divisible: bool
) -> ScansToTrainOn:
    """Return the scans of a data set for training and validation.

    Parameters
    ----------
    dataset : Path
    space : LabelSpace, optional
        Classes of the labels, by default those of the data set.
    divisible : bool
        Whether scans can be cross-validated. Without named splits, all labelled scans are then for
        training. If ``train`` or ``valid`` is missing, or some scans have no split, the scans of
        ``train`` and of no split are.

    Returns
    -------
    ScansToTrainOn

    Raises
    ------
    NoInputError
        If there are no labelled scans of the split ``train``, or of no split.
    """
    if not divisible:
        classes, training = labelled_split(dataset, space, "train")
        _, validation = labelled_split(dataset, classes, "valid")
        return ScansToTrainOn(space=classes, training=training, validation=validation)
    classes = _with_splits_of(dataset, space)
    labelled = _labelled_scans(dataset, classes)
    named = space if space and space.splits else data_set_label_space(dataset)
    if named is None or not named.splits:
        sequences = counted(len({scan.sequence for scan in labelled}), "sequence")
        scans = counted(len(labelled), "labelled scan")
        log.log(NOTICE, "no splits are named: training on %s of %s", scans, sequences)
        return ScansToTrainOn(space=classes, training=labelled, validation=[])
    splits = {scan: classes.split_of(scan.sequence) for scan in labelled}
    split_names = set(splits.values())
    if {"train", "valid"} <= split_names and None not in split_names:
        return ScansToTrainOn(
            space=classes,
            training=[scan for scan in labelled if splits[scan] == "train"],
            validation=[scan for scan in labelled if splits[scan] == "valid"],
        )
    usable = [scan for scan in labelled if splits[scan] in ("train", None)]
    log_unused(labelled, usable, classes, SPLITS_ARE_NAMED)
    if not usable:
        expected = "labelled scans of split train, or of no split"
        raise NoInputError(dataset, "every labelled scan is of another split", expected)
    return ScansToTrainOn(space=classes, training=usable, validation=[])


def _labelled_scans(dataset: Path, space: LabelSpace) -> list[ScanFile]:
    """Return the scans of a data set whose labels are more than pre-labels; refuse none.

    Without any label file, these are the LAS scans with a classification, by a label space.
    """
    files = find_scans(dataset)
    unreviewed = set(pre_labelled_scans(files))
    labelled = [file for file in files if file.label_path.is_file() and file not in unreviewed]
    text = f", {len(unreviewed)} with pre-labels only" if unreviewed else ""
    if not labelled and not unreviewed:
        labelled = classified_scans(files, space)
        if labelled:
            log.log(NOTICE, "labels: the classification in %s", counted(len(labelled), "LAS scan"))
    if not labelled:
        problem = f"none of {counted(len(files), 'scan')} has labels{text}"
        raise NoInputError(dataset, problem, f"label files such as {files[0].label_path}")
    unlabelled = len(files) - len(labelled)
    if unlabelled:
        log.log(NOTICE, "skipped without labels: %s%s", counted(unlabelled, "scan"), text)
    return labelled


def _with_splits_of(dataset: Path, space: LabelSpace | None) -> LabelSpace:
    """Return a label space, by default that of the data set, with splits."""
    if space is None:
        return with_splits(data_set_label_space(dataset) or label_space())
    return with_splits(space, dataset, alternatives=True)


def labelled_split(
    dataset: Path, space: LabelSpace | None, split: str
) -> tuple[LabelSpace, list[ScanFile]]:
    """Return the label space of a data set with splits, and the scans of a split.

    For the training split, log the sequences with labels that no split names.
    """
    space = _with_splits_of(dataset, space)
    members = space.split(split)
    files = find_scans(dataset)
    scans = [scan for scan in files if scan.sequence in members]
    if not scans:
        expected = f"one of the sequences {', '.join(members) or '(none)'}"
        folds = setting("recipe.folds", 3)
        hint = f"name the sequences of each split in labels.yaml, or cross-validate: {folds}"
        raise NoInputError(dataset, f"has no scans of split {split}", expected, hint)
    _require_label_files(scans, files)
    if split == "train":
        labelled = [scan for scan in files if scan.label_path.is_file()]
        used = [scan for scan in labelled if space.split_of(scan.sequence)]
        log_unused(labelled, used, space, SPLITS_ARE_NAMED)
    return space, scans


def _require_label_files(scans: Sequence[ScanFile], files: Sequence[ScanFile]) -> None:
    """Refuse scans to be read by their classification in a data set whose `files` have labels."""
    without = [scan for scan in scans if labels_source(scan) == scan.path]
    if without and any(file.label_path.is_file() for file in files):
        names = first_few([scan.name for scan in without])
        problem = f"{counted(len(without), 'LAS scan')} without a label file: {names}"
        expected = "label files of all scans, since some have one"
        hint = "label these scans, or remove them from the split"
        raise NoInputError(without[0].label_path, problem, expected, hint)
