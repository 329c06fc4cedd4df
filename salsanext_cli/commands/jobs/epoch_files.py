# SPDX-License-Identifier: MIT
"""Files that show a training, written after every epoch: curve, sample predictions, a page."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.geometry.projection import pixels_from_points, project
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.texts import percentage
from salsanext_cli.report.training_pictures import (
    SampleLabels,
    curve_picture,
    samples_picture,
    training_page,
)
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import evenly_spaced
from salsanext_cli.training.data.sources import Source, read_labelled
from salsanext_cli.training.fit import FinishedEpoch
from salsanext_cli.training.run_folder import CURVE, PAGE, SAMPLES
from salsanext_cli.training.tensorboard_files import write_events

SAMPLE_SCANS = 3  # Scans of which predictions are drawn

PICTURES = {
    CURVE: "Loss, and scores of the validation, by epoch",
    SAMPLES: "Truth, prediction and errors of some scans",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class EpochFiles:
    """What happens after every epoch: files that show the training are written."""

    tensorboard: bool  # Whether to write event files too

    def __call__(self, epoch: FinishedEpoch) -> None:
        """Write the files of an epoch."""
        write_epoch_files(epoch)
        if self.tensorboard:
            write_events(epoch)


def write_epoch_files(epoch: FinishedEpoch) -> None:
    """Draw the curve of a training and predictions of some scans, and write them with a page."""
    folder = OwnedFolder(epoch.run)
    rows = epoch.rows
    folder.write(epoch.run / CURVE, curve_picture(rows))
    kind = "validation" if epoch.is_validation else "training"
    number = int(rows[-1]["epoch"])
    heading = f"Predictions after epoch {number} of {epoch.epochs}   {kind} scans"
    samples = [
        sample_labels(file, epoch.scans, epoch.network)
        for file in evenly_spaced(epoch.scans.files, SAMPLE_SCANS)
    ]
    picture = samples_picture(samples, epoch.network.space, heading)
    folder.write(epoch.run / SAMPLES, picture)
    _write_page(epoch)


def _write_page(epoch: FinishedEpoch) -> None:
    """Write the page of a training, which also shows the fold that is trained now."""
    below = epoch.run.relative_to(epoch.page_folder).as_posix()
    prefix = "" if below == "." else f"{below}/"
    pictures = {f"{prefix}{name}": text for name, text in PICTURES.items()}
    is_last_epoch = int(epoch.rows[-1]["epoch"]) == epoch.epochs
    page = training_page(
        _title(epoch.page_folder),
        _state(epoch),
        pictures,
        is_running=epoch.fold > 0 or not is_last_epoch,
    )
    OwnedFolder(epoch.page_folder).write(epoch.page_folder / PAGE, page)


def sample_labels(file: ScanFile, source: Source, network: Network) -> SampleLabels:
    """Predict the pixels of a labelled scan, before the vote of the neighbours."""
    fitted = network.for_sensor(source.sensor_of(file))
    annotated = read_labelled(file, source.space, fitted.sensor)
    fitted = fitted.for_sensor(sensor_of(annotated.scan, fitted.sensor))
    image = project(annotated.scan, fitted.sensor)
    (logits,) = network.backend.logits([fitted.input(image.channels)])
    return SampleLabels(
        name=file.name,
        truth=pixels_from_points(annotated.labels, image.point_of_pixel, 0),
        predicted=logits.argmax(axis=0).astype(np.uint8),
        occupied=image.point_of_pixel >= 0,
    )


def _title(run: Path) -> str:
    return "/".join(run.absolute().parts[-2:])


def _state(epoch: FinishedEpoch) -> str:
    """Return the last epoch in words."""
    last = epoch.rows[-1]
    fold = f"fold {epoch.fold} of {epoch.folds}, " if epoch.fold else ""
    text = f"{fold}epoch {int(last['epoch'])} of {epoch.epochs}, loss {last['loss']:.3f}"
    for key, name in (("miou", "mean IoU"), ("accuracy", "accuracy")):
        scores = [row[key] for row in epoch.rows if key in row]
        if scores:
            text += f", {name} {percentage(scores[-1])}"
    return text
