# SPDX-License-Identifier: MIT
"""Options that more than one command takes, about scans, sensors and networks."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from salsanext_cli.cli.option_groups import option, option_group
from salsanext_cli.errors import UsageError

if TYPE_CHECKING:
    from salsanext_cli.classes import LabelSpace
    from salsanext_cli.geometry.knn import KnnParameters
    from salsanext_cli.inference.settings import NetworkSettings
    from salsanext_cli.sensors import Sensor
    from salsanext_cli.storage.selection import ScanSelection

SCANS_HELP = "Scan file, folder of scans, sequence folder, data set or recording."
SENSOR_HELP = "Name of a built-in sensor, or a .toml file."

Scans = Annotated[
    Path | None, typer.Argument(metavar="SCANS", help=SCANS_HELP, show_default="the data set")
]
RequiredScans = Annotated[Path, typer.Argument(metavar="SCANS", help=SCANS_HELP)]
LabelledDataSet = Annotated[
    Path,
    typer.Argument(
        metavar="DATASET",
        envvar="SALSANEXT_DATASET",
        help="Labelled data set in SemanticKITTI's layout.",
    ),
]
Out = Annotated[
    Path, typer.Argument(metavar="OUT", envvar="SALSANEXT_OUT", help="Folder for the results.")
]
OutOption = Annotated[
    Path,
    typer.Option(
        "--out", envvar="SALSANEXT_OUT", help="Folder with the results of earlier stages."
    ),
]
WeightsOut = Annotated[
    Path, typer.Argument(metavar="WEIGHTS_OUT", help="Weights file to write (.safetensors).")
]
SensorWithoutWeights = Annotated[
    str | None, typer.Option(help=SENSOR_HELP, show_default="hdl64", rich_help_panel="Network")
]
TOPIC_HELP = "Topic of the point clouds of a recording."
Topic = Annotated[str | None, typer.Option(help=TOPIC_HELP, show_default="the only one")]

selection_option = partial(option, "Selection")
network_option = partial(option, "Network")


@option_group
class Selection:
    """Selection among the scans of a source."""

    dataset: Path | None = selection_option(
        "Data set in SemanticKITTI's layout.", envvar="SALSANEXT_DATASET", show_default="."
    )
    split: str | None = selection_option("Only the sequences of this split: train, valid or test.")
    sequences: str | None = selection_option("Only these sequences, such as 00,08.")
    limit: int | None = selection_option("At most this number of scans, the first ones.")

    def source(self, scans: Path | None) -> Path:
        """Return where to look for scans: SCANS, else the data set, else the current folder."""
        return scans or self.dataset or Path()

    def scans(self) -> ScanSelection:
        """Build the selection that stages take."""
        from salsanext_cli.storage.selection import ScanSelection

        names = tuple(name.strip() for name in (self.sequences or "").split(",") if name.strip())
        if self.sequences is not None and not names:
            expected = "names of sequences, such as 00,08"
            raise UsageError("--sequences", repr(self.sequences), expected)
        return ScanSelection(self.split, names, self.limit)


@option_group
class SourceSelection(Selection):
    """Selection among the scans of a source that may be a recording."""

    topic: str | None = selection_option(TOPIC_HELP, show_default="the only one")

    def source(self, scans: Path | None) -> Path:
        """Return where to look for scans, in a recording the topic that was named."""
        return in_topic(Selection.source(self, scans), self.topic)


def in_topic(source: Path, topic: str | None) -> Path:
    """Return the path of a topic in a recording, of the recording where none is named."""
    if topic is None:
        return source
    from salsanext_cli.formats.recordings.address import is_recording

    if not is_recording(source):
        raise UsageError("--topic", f"{source} is no recording", "SCANS that are one")
    return source / topic.strip("/")


@option_group
class SpacedSelection(Selection):
    """Selection whose limit takes scans evenly spaced."""

    limit: int | None = selection_option("At most this number of scans, evenly spaced.")


@option_group
class LabelledSelection(SpacedSelection):
    """Selection among labelled scans: those for validation, unless others are named."""

    split: str | None = selection_option(
        "Only the sequences of this split: train or valid.",
        show_default="valid, without --sequences",
    )

    def scans(self) -> ScanSelection:
        """Build the selection that stages take."""
        split = self.split or (None if self.sequences else "valid")
        return Selection(self.dataset, split, self.sequences, self.limit).scans()


@option_group
class Classes:
    """Label space of the data."""

    label_space: str | None = selection_option(
        "Name of a built-in label space, or a .yaml file in SemanticKITTI's format.",
        show_default="that of the data set, else semantic-kitti",
    )

    def space(self) -> LabelSpace | None:
        """Look up the label space, None where none was named."""
        return label_space(self.label_space)


@option_group
class ResultSelection(Selection):
    """Selection among the scans of which an output folder holds results."""

    dataset: Path | None = selection_option(
        "Data set with the scans and labels; SALSANEXT_DATASET for results that do not record it.",
        show_default="the one that the results record, else .",
    )


@option_group
class NetworkOptions:
    """Network, its sensor and its device."""

    weights: Path | None = network_option(
        "Weights file (.safetensors), or .onnx of export-onnx.", show_default="the default weights"
    )
    device: str = network_option(
        "cpu, cuda, cuda:1 …; auto uses a GPU if there is one.", default="auto"
    )
    precision: str = network_option(
        "float32, bfloat16 or float16; auto chooses what is fast on the device.",
        default="auto",
        envvar="SALSANEXT_PRECISION",
    )
    engine: str = network_option(
        "openvino (CPUs) or torch; auto takes OpenVINO on a CPU where it runs.",
        default="auto",
        envvar="SALSANEXT_ENGINE",
    )
    sensor: str | None = network_option(SENSOR_HELP, show_default="the sensor of the weights")

    def settings(self) -> NetworkSettings:
        """Build the settings that stages take."""
        from salsanext_cli.inference.settings import NetworkSettings

        named = sensor(self.sensor)
        return NetworkSettings(self.weights, self.device, named, self.precision, self.engine)

    def sensor_to_project(self) -> Sensor:
        """Return the sensor that was named, else the one that the weights were trained with."""
        from salsanext_cli.network.card import default_weights, read_card

        return sensor(self.sensor) or read_card(self.weights or default_weights()).sensor


@option_group
class Knn:
    """Refinement of labels by nearest neighbours."""

    knn_k: int = network_option("Number of neighbours that vote.", default=5)
    knn_window: int = network_option("Side of the window of neighbours, in pixels.", default=5)
    knn_sigma: float = network_option(
        "Standard deviation of the Gaussian weights, in pixels.", default=1.0
    )
    knn_cutoff: float = network_option(
        "Maximum range difference of a neighbour, in metres.", default=1.0
    )

    def parameters(self) -> KnnParameters:
        """Build the parameters that stages take."""
        from salsanext_cli.geometry.knn import KnnParameters

        return KnnParameters(self.knn_k, self.knn_window, self.knn_sigma, self.knn_cutoff)


def sensor(name: str | None) -> Sensor | None:
    """Look up a sensor, None where none was named."""
    from salsanext_cli.sensors import sensor as find

    return None if name is None else find(name)


def label_space(name: str | None) -> LabelSpace | None:
    """Look up a label space, None where none was named."""
    from salsanext_cli.classes import label_space as find

    return None if name is None else find(name)
