# SPDX-License-Identifier: MIT
"""Options that more than one command takes, about scans, sensors and networks."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from salsanext_cli.cli.option_groups import Shown, Without
from salsanext_cli.errors import UsageError
from salsanext_cli.options import ScanSelection, argument, option, option_group
from salsanext_cli.parallel.options import RunOptions

if TYPE_CHECKING:
    from salsanext_cli.classes.label_space import LabelSpace
    from salsanext_cli.engines.settings import NetworkSettings
    from salsanext_cli.geometry.knn import KnnParameters
    from salsanext_cli.sensors.sensor import Sensor

OUT_VARIABLE = "SALSANEXT_OUT"
DEFAULT_WEIGHTS = Path("default")
"""Name of the weights of the package; a file of that name needs an absolute path."""
SCANS_HELP = "Scan file, folder of scans, sequence folder, data set or recording."
SENSOR_HELP = "Name of a built-in sensor, or a .toml file."
COLUMNS_HELP = "Columns of files that do not name them, such as x,y,z,intensity,ring; _ for others."
COLUMNS_DEFAULT = "those of the sensor, else x,y,z,intensity"
ByDistance = Annotated[
    bool, typer.Option("--by-distance", help="Also evaluate by distance from the sensor.")
]

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
    Path, typer.Argument(metavar="OUT", envvar=OUT_VARIABLE, help="Folder for the results.")
]
WeightsOut = Annotated[
    Path, typer.Argument(metavar="WEIGHTS_OUT", help="Weights file to write (.safetensors).")
]
SensorWithoutWeights = Annotated[
    str | None, typer.Option(help=SENSOR_HELP, show_default="hdl64", rich_help_panel="Network")
]
Columns = Annotated[
    str | None,
    typer.Option(help=COLUMNS_HELP, show_default=COLUMNS_DEFAULT, rich_help_panel="Network"),
]

TOPIC_HELP, TOPIC_DEFAULT = "Topic of the point clouds of a recording.", "the only one"
TopicOfRecording = Annotated[str | None, typer.Option(help=TOPIC_HELP, show_default=TOPIC_DEFAULT)]
Topic = Annotated[
    str | None,
    typer.Option(help=TOPIC_HELP, show_default=TOPIC_DEFAULT, rich_help_panel="Selection"),
]
DataSet = Annotated[
    Path | None,
    typer.Option(
        help="Data set in SemanticKITTI's layout.",
        envvar="SALSANEXT_DATASET",
        show_default=".",
        rich_help_panel="Selection",
    ),
]
DataSetOfResults = Annotated[
    Path | None,
    typer.Option(
        help="Data set with the scans and labels; SALSANEXT_DATASET for results that do not record "
        "it.",
        show_default="the one that the results record, else .",
        rich_help_panel="Selection",
    ),
]
LabelSpaceName = Annotated[
    str | None,
    typer.Option(
        help="Name of a built-in label space, or a .yaml file in SemanticKITTI's format.",
        show_default="that of the data set, else semantic-kitti",
        rich_help_panel="Selection",
    ),
]
MergedInto = Annotated[
    str | None,
    typer.Option(
        help="Merge the classes into those of a label space: coarse, or a .yaml file. "
        "Probabilities of merged classes are added.",
        show_default="not merged",
        rich_help_panel="Selection",
    ),
]
EVENLY_SPACED = {"help": "At most this number of scans, evenly spaced."}
SpacedSelection = Annotated[ScanSelection, Shown(limit=EVENLY_SPACED)]
LabelledSelection = Annotated[
    ScanSelection,
    Shown(
        split={
            "help": "Only the sequences of this split: train or valid.",
            "show_default": "valid, without --sequences",
        },
        limit=EVENLY_SPACED,
    ),
]
Jobs = Annotated[
    int,
    typer.Option(
        "--jobs", "-j", help="Number of processes; -1: one per core.", rich_help_panel="Running"
    ),
]
Overwrite = Annotated[
    bool,
    typer.Option("--overwrite", help="Replace existing results.", rich_help_panel="Running"),
]
Strict = Annotated[
    bool,
    typer.Option(
        "--strict",
        help="End with status 1 if a scan or its labels are doubtful.",
        rich_help_panel="Running",
    ),
]
Unsharded = Annotated[RunOptions, Without({"shard"})]
Reading = Annotated[RunOptions, Without({"shard", "overwrite"})]
"""For results over all scans, which several runs cannot share."""

Intensity = Literal["auto", "match", "raw", "none"]

AUTO = "auto"


network_option = partial(option, "Network")


@option_group
class NetworkOptions:
    """Network, its sensor and its device."""

    weights: Path | None = network_option(
        "Weights file (.safetensors), or .onnx of export-onnx; default: those of the package.",
        show_default="default",
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
    sensor: str = network_option(
        "Name of a built-in sensor, or a .toml file; auto is that of the weights, with view, "
        "direction up and place of the scans' own where they differ much. A name tells noise and "
        "scale of intensity only.",
        default=AUTO,
    )
    columns: str | None = network_option(COLUMNS_HELP, show_default=COLUMNS_DEFAULT)
    min_range: float | None = network_option(
        "Leave points nearer than this unlabelled, in metres: housing and mount of the sensor.",
        show_default="1, or 0.8 of the height of a lower sensor",
    )
    ego: str = network_option(
        "Box around what the sensor sees of its own vehicle, whose points stay unlabelled: least "
        "x, y, z and largest x, y, z in metres, or none; auto finds it in the scans of a drive.",
        default=AUTO,
    )
    intensity: Intensity = network_option(
        "Match the intensity of the scans to that of training, take it raw, or take none; auto "
        "matches it if the weights know that of their training.",
        default="auto",
    )

    def settings(self, *, sized: bool = False) -> NetworkSettings:
        """Build the settings that stages take; `sized` as for `named_sensor`."""
        from salsanext_cli.engines.settings import NetworkSettings

        weights = None if self.weights == DEFAULT_WEIGHTS else self.weights
        fit = self.is_fitted and not (sized and self.sensor != AUTO)
        how = (self.precision, self.engine, fit, self.intensity)
        return NetworkSettings(weights, self.device, self.named_sensor(sized=sized), *how)

    @property
    def is_fitted(self) -> bool:
        """True if the view is that of the weights, fitted to the scans; a file tells its own."""
        from salsanext_cli.sensors.sensor import presets

        return self.sensor == AUTO or self.sensor in presets()

    def named_sensor(self, *, sized: bool = False) -> Sensor | None:
        """Look up the sensor that was named; what it does not tell is that of the weights.

        Of a built-in sensor that is all but noise and scale of intensity; `sized` ones have their
        own size and view.
        """
        from salsanext_cli.sensors.sensor import OF_DEVICE

        named = None if self.sensor == AUTO else sensor(self.sensor, self.trained_sensor)
        if named and self.is_fitted and not sized:
            own = {key: getattr(named, key) for key in OF_DEVICE}
            named = replace(self.trained_sensor(), **own)
        if self.columns is not None:
            named = with_columns(named or self.trained_sensor(), self.columns)
        if self.min_range is not None:
            named = replace(named or self.trained_sensor(), min_range=self.min_range)
        if self.ego != AUTO:
            named = replace(named or self.trained_sensor(), ego_box=ego_box(self.ego))
        # Those of training are not those of the scans.
        return named and replace(named, intensity_quantiles=(), row_gaps=None)

    def trained_sensor(self) -> Sensor:
        """Return the sensor that the weights were trained with."""
        from salsanext_cli.network.card import read_card

        return read_card(weights_file(self.weights)).sensor


@option_group
class AdaptableNetwork(NetworkOptions):
    """Network that can be adapted to the scans, its sensor and its device."""

    adapt: bool = network_option(
        "Adapt batch normalisation to the scans, once for the output folder.",
        "--adapt",
        default=False,
    )

    def settings(self, *, sized: bool = False) -> NetworkSettings:
        """Build the settings that stages take; `sized` as for `named_sensor`."""
        return replace(NetworkOptions.settings(self, sized=sized), adapt=self.adapt)


@option_group
class Results:
    """Output folder of earlier stages, given as OUT or as --out."""

    out: Path | None = argument(
        "Folder with the results of earlier stages.",
        metavar="OUT",
        show_default=f"{OUT_VARIABLE}, else out",
    )
    out_option: Path | None = option("Options", "The same as OUT.", "--out")

    def folder(self) -> Path:
        """Return the output folder, which may be given once."""
        if self.out and self.out_option:
            raise UsageError("OUT and --out", "both given", "one of them")
        return self.out or self.out_option or Path(os.environ.get(OUT_VARIABLE) or "out")


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


def weights_file(path: Path | None) -> Path:
    """Return a weights file, that of the package for none or for the name `DEFAULT_WEIGHTS`."""
    from salsanext_cli.network.card import default_weights

    return default_weights() if path in (None, DEFAULT_WEIGHTS) else path


def sensor(name: str | None, base: Callable[[], Sensor] | None = None) -> Sensor | None:
    """Look up a sensor, None where none was named; `base` has what its file does not tell."""
    from salsanext_cli.sensors.sensor import presets
    from salsanext_cli.sensors.sensor import sensor as find

    if name is None:
        return None
    return find(name) if base is None or name in presets() else find(name, base())


def ego_box(text: str) -> tuple[float, ...]:
    """Return the box that a text tells, nothing for ``none``."""
    from salsanext_cli.sensors.sensor import BOX_EXPECTED, is_box

    box: tuple[float, ...] = ()
    if text != "none":
        with suppress(ValueError):
            box = tuple(float(number) for number in text.split(","))
        if not box or not is_box(box):
            raise UsageError("--ego", text, f"auto, or {BOX_EXPECTED}")
    return box


def with_columns(sensor: Sensor, columns: str | None) -> Sensor:
    """Return a sensor whose files have other columns, if some were named."""
    if columns is None:
        return sensor
    from salsanext_cli.sensors.sensor import COLUMNS_EXPECTED, are_columns

    names = tuple(name.strip().lower() for name in columns.split(","))
    if not are_columns(names):
        raise UsageError("--columns", columns, COLUMNS_EXPECTED)
    return replace(sensor, columns=names)


def source(scans: Path | None, dataset: Path | None, topic: str | None) -> Path:
    """Return where to look for scans: SCANS, else the data set, else here; a topic if named."""
    return in_topic(scans or dataset or Path(), topic)


def in_topic(source: Path, topic: str | None) -> Path:
    """Return the path of a topic in a recording, of the recording where none is named."""
    if topic is None:
        return source
    from salsanext_cli.formats.recordings import is_recording

    if not is_recording(source):
        raise UsageError("--topic", f"{source} is no recording", "SCANS that are one")
    return source / topic.strip("/")


def label_space(name: str | None) -> LabelSpace | None:
    """Look up a label space, None where none was named."""
    from salsanext_cli.classes.label_space import label_space as find

    return None if name is None else find(name)
