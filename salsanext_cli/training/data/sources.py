# SPDX-License-Identifier: MIT
"""Data sets to train on: labelled scans, their label space and the sensors that recorded them."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path

import joblib
import numpy as np

from salsanext_cli.classes.label_space import LabelSpace, label_space
from salsanext_cli.classes.merging import ClassMerging, is_merged
from salsanext_cli.errors import NOTICE, LabelError, NoInputError, counted, first_few
from salsanext_cli.fitting.field_of_view import fit_view
from salsanext_cli.fitting.sensor_fit import ScanSample, with_image_statistics
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.geometry.network_input import on_other_scale
from salsanext_cli.geometry.projection import ego_points, in_sensor_frame, project
from salsanext_cli.labelling.label_records import pre_labelled_scans
from salsanext_cli.records import Float
from salsanext_cli.results.paths import ScanFile, find_scans
from salsanext_cli.results.selection import data_set_label_space, log_unused, with_splits
from salsanext_cli.sensors.sensor import FITTED_NAME, Sensor
from salsanext_cli.training.data.augment import LabelledScan
from salsanext_cli.training.data.targets import ClassSets, to_targets

SPLITS_ARE_NAMED = "labels.yaml in the data set names the sequences of each split"

log = logging.getLogger(__name__)


def read_labelled(
    file: ScanFile, space: LabelSpace, sensor: Sensor, sets: ClassSets = ()
) -> LabelledScan:
    """Read a scan and the targets of its points, (N,) uint8; without sets these are train ids."""
    scan = read_scan(file.path, sensor)
    raw = read_labels(file.label_path, len(scan))
    return scan, to_targets(raw, space, sets, file.label_path)


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """Labelled scans of one data set, their label space and sensor."""

    files: Sequence[ScanFile]
    space: LabelSpace
    sensor: Sensor  # That the network is trained for
    # Those of sequences, as `predict` fits them; empty if all scans are taken as `sensor` says
    fitted: Mapping[str, Sensor] = field(default_factory=dict)
    simulated: bool = False  # Scans that the user knows nothing of

    def sensor_of(self, file: ScanFile) -> Sensor:
        """Return the sensor that a scan is projected with."""
        return self.fitted.get(file.sequence, self.sensor)

    def read(self, file: ScanFile, sets: ClassSets) -> LabelledScan:
        """Read a scan, but the vehicle's points, in the sensor's frame, and its targets, (N,)."""
        own = self.sensor_of(file)
        scan, targets = read_labelled(file, self.space, own, sets)
        scan = in_sensor_frame(scan, own)
        if len(ego := ego_points(scan.points, own)):
            rest = np.delete(np.arange(len(scan)), ego)
            scan, targets = scan.take(rest), targets[rest]
        quantiles, of_training = own.intensity_quantiles, self.sensor.intensity_quantiles
        if quantiles and of_training and quantiles != of_training:
            scan = replace(scan, intensity=on_other_scale(scan.intensity, quantiles, of_training))
        return scan, targets


def training_sources(sources: Sequence[Source], *, fit: bool, jobs: int = 1) -> list[Source]:
    """Return sources as training sees them, fitted or not, with intensity and gaps of the first."""
    if fit:
        sources = [fitted_source(source, jobs) for source in sources]
    first = sources[0]
    if fit and first.sensor.intensity_quantiles:
        # What the weights to start from were trained to see: each sequence is fitted to that.
        return list(sources)

    def image_of(file: ScanFile) -> Float:
        own = first.sensor_of(file)
        return project(read_scan(file.path, own), own).channels

    images = ScanSample(first.files, first.sensor, image_of).images(first.sensor)
    sensor = with_image_statistics(first.sensor, images)
    return [replace(source, sensor=sensor) for source in sources]


def fitted_source(source: Source, jobs: int = 1) -> Source:
    """Return a source with the sensor of each sequence fitted to its scans, as `predict` does."""
    if not source.files:
        return source
    sequences = {name: list(files) for name, files in groupby(source.files, lambda f: f.sequence)}

    def fit(files: Sequence[ScanFile]) -> Sensor:
        scans = ScanSample(files, source.sensor).scans
        sensor = fit_view(scans, source.sensor)
        return with_image_statistics(sensor, [project(scan, sensor).channels for scan in scans])

    run = joblib.Parallel(jobs, backend="threading")
    sensors = run(joblib.delayed(fit)(files) for files in sequences.values())
    changed = sum(sensor.name == FITTED_NAME for sensor in sensors)
    counts = counted(len(sensors), "sequence")
    log.log(NOTICE, "%s fitted, %d of them with another view or mounting", counts, changed)
    return replace(source, fitted=dict(zip(sequences, sensors, strict=True)))


def further_source(dataset: Path, space: LabelSpace, sensor: Sensor) -> Source:
    """Return the training split of a further data set, its classes merged into those of a space."""
    own, files = labelled_split(dataset, None, "train")
    _log_unsplit(dataset, own)
    classes = merged_into(own, space)
    if classes is None:
        found = f"other classes ({first_few(own.differences(space))})"
        raise LabelError(dataset, found, f"those of {space.name}")
    return Source(files, classes, sensor)


def merged_into(own: LabelSpace, space: LabelSpace) -> LabelSpace | None:
    """Return a label space with the classes of another, None if they are not merged into these."""
    if is_merged(space, own):
        # The first data set may tell other classes apart than this one.
        own = ClassMerging.between(own, replace(space, splits={}, alternatives={})).space
    return own if own.fits(space) else None


def scans_to_train_on(
    dataset: Path, space: LabelSpace | None, *, divisible: bool
) -> tuple[LabelSpace, list[ScanFile], list[ScanFile]]:
    """Return the label space of a data set, its training scans and its validation scans."""
    # If it is `divisible`, a validation split may lack: all labelled scans are trained on where no
    # splits are named; where one is in none, or ``train`` or ``valid`` is empty, all but those of
    # other splits than ``train``.
    if not divisible:
        classes, training = labelled_split(dataset, space, "train")
        _log_unsplit(dataset, classes)
        return classes, training, labelled_split(dataset, classes, "valid")[1]
    classes = with_splits_of(dataset, space)
    found = find_scans(dataset)
    guesses = {*pre_labelled_scans(found)}
    labelled = [scan for scan in found if scan.label_path.is_file() and scan not in guesses]
    text = f", {len(guesses)} with a network's first guess only" if guesses else ""
    if not labelled:
        none = f"none of {counted(len(found), 'scan')} has labels{text}"
        raise NoInputError(dataset, none, f"label files such as {found[0].label_path}")
    if unlabelled := len(found) - len(labelled):
        log.log(NOTICE, "left out without labels: %s%s", counted(unlabelled, "scan"), text)
    own = space if space and space.splits else data_set_label_space(dataset)
    if own is None or not own.splits:
        found_in = counted(len({scan.sequence for scan in labelled}), "sequence")
        scans = counted(len(labelled), "labelled scan")
        log.log(NOTICE, "no splits are named: training on %s of %s", scans, found_in)
        return classes, labelled, []
    of_split = {scan: classes.split_of(scan.sequence) for scan in labelled}
    if {"train", "valid"} <= {*of_split.values()} and None not in of_split.values():
        parts = [[s for s in labelled if of_split[s] == name] for name in ("train", "valid")]
        return classes, parts[0], parts[1]
    usable = [scan for scan in labelled if of_split[scan] in ("train", None)]
    log_unused(labelled, usable, classes, SPLITS_ARE_NAMED)
    if not usable:
        expected = "labelled scans of split train, or of none"
        raise NoInputError(dataset, "every labelled scan is of another split", expected)
    return classes, usable, []


def with_splits_of(dataset: Path, space: LabelSpace | None) -> LabelSpace:
    """Return the label space of a data set with splits; parameters as of `labelled_split`."""
    if space is None:
        return with_splits(data_set_label_space(dataset) or label_space())
    return with_splits(space, dataset, alternatives=True)


def _log_unsplit(dataset: Path, space: LabelSpace) -> None:
    """Log the sequences with labels that no split names."""
    labelled = [scan for scan in find_scans(dataset) if scan.label_path.is_file()]
    used = [scan for scan in labelled if space.split_of(scan.sequence)]
    log_unused(labelled, used, space, SPLITS_ARE_NAMED)


def labelled_split(
    dataset: Path, space: LabelSpace | None, split: str
) -> tuple[LabelSpace, list[ScanFile]]:
    """Return the label space of a data set, completed as `with_splits_of`, and a split's scans."""
    space = with_splits_of(dataset, space)
    members = space.split(split)
    scans = [scan for scan in find_scans(dataset) if scan.sequence in members]
    if not scans:
        expected = f"one of the sequences {', '.join(members) or '(none)'}"
        hint = "name your sequences in labels.yaml, under split, or cross-validate: --set folds=3"
        raise NoInputError(dataset, f"no scans of split {split}", expected, hint)
    return space, scans
