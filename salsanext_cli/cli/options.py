# SPDX-License-Identifier: MIT
"""Every option that more than one command takes, once."""

from __future__ import annotations

import os
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from salsanext_cli.errors import UsageError

if TYPE_CHECKING:
    from salsanext_cli.classes import LabelSpace
    from salsanext_cli.geometry.knn import KnnParameters
    from salsanext_cli.inference.settings import NetworkSettings
    from salsanext_cli.sensors import Sensor as SensorRecord
    from salsanext_cli.storage.selection import ScanSelection

SELECTION, NETWORK, RUNNING, TALK = "Selection", "Network", "Running", "Output"


class OnError(StrEnum):
    """What becomes of a run when a scan fails."""

    skip = "skip"
    stop = "stop"


Scans = Annotated[
    Path | None,
    typer.Argument(
        metavar="SCANS",
        help="A scan, a folder of scans, a sequence or a data set.",
        show_default="the data set",
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
DataSet = Annotated[
    Path | None,
    typer.Option(
        "--dataset",
        envvar="SALSANEXT_DATASET",
        help="Data set in SemanticKITTI's layout.",
        show_default=".",
        rich_help_panel=SELECTION,
    ),
]
DataSetOfResults = Annotated[
    Path | None,
    typer.Option(
        "--dataset",
        help="Where scans and labels are; SALSANEXT_DATASET where that is not known.",
        show_default="where the scans came from, else .",
        rich_help_panel=SELECTION,
    ),
]
Split = Annotated[
    str | None,
    typer.Option(
        help="Only the sequences of a split: train, valid, test.", rich_help_panel=SELECTION
    ),
]
Sequences = Annotated[
    str | None,
    typer.Option(help="Only these sequences, such as 00,08.", rich_help_panel=SELECTION),
]
Limit = Annotated[
    int | None, typer.Option(help="Only so many scans, the first.", rich_help_panel=SELECTION)
]
LimitSpaced = Annotated[
    int | None, typer.Option(help="Only so many scans, evenly spaced.", rich_help_panel=SELECTION)
]
SplitOfLabels = Annotated[
    str | None,
    typer.Option(
        "--split",
        help="Only the sequences of a split: train, valid.",
        show_default="valid, without --sequences",
        rich_help_panel=SELECTION,
    ),
]
LabelledDataSet = Annotated[
    Path,
    typer.Argument(
        metavar="DATASET",
        envvar="SALSANEXT_DATASET",
        help="Labelled, in SemanticKITTI's layout.",
    ),
]
WeightsOut = Annotated[
    Path, typer.Argument(metavar="WEIGHTS_OUT", help="The .safetensors file to write.")
]
Sensor = Annotated[
    str | None,
    typer.Option(
        help="Name of a sensor or a .toml file.",
        show_default="the one of the weights",
        rich_help_panel=NETWORK,
    ),
]
SensorWithoutWeights = Annotated[
    str | None,
    typer.Option(
        "--sensor",
        help="Name of a sensor or a .toml file.",
        show_default="hdl64",
        rich_help_panel=NETWORK,
    ),
]
LabelSpaceOption = Annotated[
    str | None,
    typer.Option(
        "--label-space",
        help="Name of a label space or a .yaml file in SemanticKITTI's form.",
        show_default="the data set's own, else semantic-kitti",
        rich_help_panel=SELECTION,
    ),
]
Weights = Annotated[
    Path | None,
    typer.Option(
        help="A weights file.", show_default="the default weights", rich_help_panel=NETWORK
    ),
]
Device = Annotated[
    str, typer.Option(help="cpu, cuda, cuda:1 …; auto takes a GPU.", rich_help_panel=NETWORK)
]
Precision = Annotated[
    str,
    typer.Option(
        envvar="SALSANEXT_PRECISION",
        help="float32, bfloat16, float16; auto: what the device is fast at.",
        rich_help_panel=NETWORK,
    ),
]
K = Annotated[int, typer.Option("--knn-k", help="Neighbours that vote.", rich_help_panel=NETWORK)]
Window = Annotated[
    int, typer.Option("--knn-window", help="Side of their window.", rich_help_panel=NETWORK)
]
Sigma = Annotated[
    float, typer.Option("--knn-sigma", help="Gaussian, in pixels.", rich_help_panel=NETWORK)
]
Cutoff = Annotated[
    float, typer.Option("--knn-cutoff", help="Farthest voter, in metres.", rich_help_panel=NETWORK)
]
Jobs = Annotated[
    int,
    typer.Option(
        "--jobs", "-j", help="Processes side by side; -1: all cores.", rich_help_panel=RUNNING
    ),
]
Overwrite = Annotated[
    bool,
    typer.Option("--overwrite", help="Make results again that exist.", rich_help_panel=RUNNING),
]
OnErrorOption = Annotated[
    OnError,
    typer.Option("--on-error", help="Skip a scan that fails, or stop.", rich_help_panel=RUNNING),
]
Json = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on stdout.", rich_help_panel=TALK)
]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Say more on stderr.", rich_help_panel=TALK)
]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Say only what went wrong.", rich_help_panel=TALK)
]


def source(scans: Path | None, dataset: Path | None = None) -> Path:
    """Return where to look for scans: what was said, else the data set, else here."""
    return scans or dataset or Path()


def usual_dataset() -> Path:
    """Return where to look for scans of which nobody knows where they came from."""
    return Path(os.environ.get("SALSANEXT_DATASET", ""))


def choice(split: str | None, sequences: str | None, limit: int | None) -> ScanSelection:
    """Gather which scans are wanted."""
    from salsanext_cli.storage.selection import ScanSelection

    names = tuple(name.strip() for name in (sequences or "").split(",") if name.strip())
    if sequences is not None and not names:
        raise UsageError("--sequences", repr(sequences), "names of sequences, such as 00,08")
    return ScanSelection(split, names, limit)


def labelled_selection(
    split: str | None, sequences: str | None, limit: int | None
) -> ScanSelection:
    """Gather which labelled scans are wanted: those for validation unless others are named."""
    return choice(split or (None if sequences else "valid"), sequences, limit)


def sensor(name: str) -> SensorRecord:
    """Look up a sensor."""
    from salsanext_cli.sensors import sensor as find

    return find(name)


def sensor_of(weights: Path | None) -> SensorRecord:
    """Return the sensor that weights were trained with, so that what is projected fits them."""
    from salsanext_cli.network.weights import default_weights, read_card

    return read_card(weights or default_weights()).sensor


def label_space(name: str | None) -> LabelSpace | None:
    """Look up a label space, None where none was named."""
    from salsanext_cli.classes import label_space as find

    return None if name is None else find(name)


def network(
    weights: Path | None, device: str, sensor_name: str | None, precision: str
) -> NetworkSettings:
    """Gather which network is wanted."""
    from salsanext_cli.inference.settings import NetworkSettings

    return NetworkSettings(weights, device, sensor(sensor_name) if sensor_name else None, precision)


def knn(k: int, window: int, sigma: float, cutoff: float) -> KnnParameters:
    """Gather how neighbours are found."""
    from salsanext_cli.geometry.knn import KnnParameters

    return KnnParameters(k, window, sigma, cutoff)
