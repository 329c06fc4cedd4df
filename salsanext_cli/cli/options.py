# SPDX-License-Identifier: MIT
"""Options that more than one command takes, about scans, sensors and networks."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from salsanext_cli.cli.option_groups import OptionGroup
from salsanext_cli.errors import UsageError

if TYPE_CHECKING:
    from salsanext_cli.classes import LabelSpace
    from salsanext_cli.geometry.knn import KnnParameters
    from salsanext_cli.inference.settings import NetworkSettings
    from salsanext_cli.sensors import Sensor
    from salsanext_cli.storage.selection import ScanSelection

selection_option = partial(typer.Option, rich_help_panel="Selection")
network_option = partial(typer.Option, rich_help_panel="Network")
sensor_option = partial(network_option, help="Name of a built-in sensor, or a .toml file.")

SCANS_HELP = "Scan file, folder of scans, sequence folder or data set."

Scans = Annotated[
    Path | None, typer.Argument(metavar="SCANS", help=SCANS_HELP, show_default="the data set")
]
RequiredScans = Annotated[Path, typer.Argument(metavar="SCANS", help=SCANS_HELP)]
Out = Annotated[
    Path, typer.Argument(metavar="OUT", envvar="SALSANEXT_OUT", help="Folder for the results.")
]
OutOption = Annotated[
    Path,
    typer.Option(
        "--out", envvar="SALSANEXT_OUT", help="Folder with the results of earlier stages."
    ),
]
LabelledDataSet = Annotated[
    Path,
    typer.Argument(
        metavar="DATASET",
        envvar="SALSANEXT_DATASET",
        help="Labelled data set in SemanticKITTI's layout.",
    ),
]
WeightsOut = Annotated[
    Path, typer.Argument(metavar="WEIGHTS_OUT", help="Weights file to write (.safetensors).")
]
SensorWithoutWeights = Annotated[str | None, sensor_option(show_default="hdl64")]
LabelSpaceOption = Annotated[
    str | None,
    selection_option(
        help="Name of a built-in label space, or a .yaml file in SemanticKITTI's format.",
        show_default="that of the data set, else semantic-kitti",
    ),
]
Device = Annotated[
    str, network_option(help="cpu, cuda, cuda:1 …; auto uses a GPU if there is one.")
]


@dataclass(frozen=True, slots=True)
class Selection(OptionGroup):
    """Selection among the scans of a source."""

    dataset: Annotated[
        Path | None,
        selection_option(
            envvar="SALSANEXT_DATASET",
            help="Data set in SemanticKITTI's layout.",
            show_default=".",
        ),
    ] = None
    split: Annotated[
        str | None,
        selection_option(help="Only the sequences of this split: train, valid or test."),
    ] = None
    sequences: Annotated[
        str | None, selection_option(help="Only these sequences, such as 00,08.")
    ] = None
    limit: Annotated[
        int | None, selection_option(help="At most this number of scans, the first ones.")
    ] = None

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


@dataclass(frozen=True, slots=True)
class ResultSelection(Selection):
    """Selection among the scans of which an output folder holds results."""

    dataset: Annotated[
        Path | None,
        selection_option(
            help="Data set with the scans and labels; SALSANEXT_DATASET for results that do not "
            "record it.",
            show_default="the one that the results record, else .",
        ),
    ] = None
    label_space: LabelSpaceOption = None

    def usual_dataset(self) -> Path:
        """Return the data set of results that do not record theirs."""
        return Path(os.environ.get("SALSANEXT_DATASET", ""))

    def space(self) -> LabelSpace | None:
        """Look up the label space, None where none was named."""
        return label_space(self.label_space)


@dataclass(frozen=True, slots=True)
class SpacedSelection(Selection):
    """Selection whose limit takes scans evenly spaced."""

    limit: Annotated[
        int | None, selection_option(help="At most this number of scans, evenly spaced.")
    ] = None


@dataclass(frozen=True, slots=True)
class LabelledSelection(SpacedSelection):
    """Selection among labelled scans: those for validation, unless others are named."""

    split: Annotated[
        str | None,
        selection_option(
            help="Only the sequences of this split: train or valid.",
            show_default="valid, without --sequences",
        ),
    ] = None

    def scans(self) -> ScanSelection:
        """Build the selection that stages take."""
        split = self.split or (None if self.sequences else "valid")
        return Selection.scans(replace(self, split=split))


@dataclass(frozen=True, slots=True)
class NetworkOptions(OptionGroup):
    """Network, its sensor and its device."""

    weights: Annotated[
        Path | None,
        network_option(help="Weights file (.safetensors).", show_default="the default weights"),
    ] = None
    device: Device = "auto"
    precision: Annotated[
        str,
        network_option(
            envvar="SALSANEXT_PRECISION",
            help="float32, bfloat16 or float16; auto chooses what is fast on the device.",
        ),
    ] = "auto"
    sensor: Annotated[str | None, sensor_option(show_default="the sensor of the weights")] = None

    def settings(self) -> NetworkSettings:
        """Build the settings that stages take."""
        from salsanext_cli.inference.settings import NetworkSettings

        return NetworkSettings(self.weights, self.device, sensor(self.sensor), self.precision)

    def sensor_to_project(self) -> Sensor:
        """Return the sensor that was named, else the one that the weights were trained with."""
        from salsanext_cli.network.weights import default_weights, read_card

        return sensor(self.sensor) or read_card(self.weights or default_weights()).sensor


@dataclass(frozen=True, slots=True)
class Knn(OptionGroup):
    """Refinement of labels by nearest neighbours."""

    knn_k: Annotated[int, network_option(help="Number of neighbours that vote.")] = 5
    knn_window: Annotated[
        int, network_option(help="Side of the window of neighbours, in pixels.")
    ] = 5
    knn_sigma: Annotated[
        float, network_option(help="Standard deviation of the Gaussian weights, in pixels.")
    ] = 1.0
    knn_cutoff: Annotated[
        float, network_option(help="Maximum range difference of a neighbour, in metres.")
    ] = 1.0

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
