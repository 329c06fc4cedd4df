# SPDX-License-Identifier: MIT
"""Options that more than one command takes, about scans, sensors and networks."""

import os
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from salsanext_cli.cli.expansion import Default, Shown, Without
from salsanext_cli.engines.settings import COLUMNS_DEFAULT, COLUMNS_HELP, NetworkSettings
from salsanext_cli.errors import UsageError
from salsanext_cli.formats import RECORDING_SUFFIXES, SCAN_SUFFIXES
from salsanext_cli.option_fields import ScanSelection, argument, option, option_group
from salsanext_cli.parallel.run_options import RunOptions
from salsanext_cli.results.query import DATASET_VARIABLE, ResultQuery

if TYPE_CHECKING:
    from salsanext_cli.sensors.sensor import Sensor

OUT_VARIABLE = "SALSANEXT_OUT"
SCANS_HELP = "Scan file, folder of scans, sequence folder, data set or recording."
SENSOR_HELP = "Name of a built-in sensor, or a .toml file."
EVENLY_SPACED = {"help": "At most this number of scans, evenly spaced."}

selection_option = partial(typer.Option, rich_help_panel="Selection")
network_option = partial(typer.Option, rich_help_panel="Network")
running_option = partial(typer.Option, rich_help_panel="Running")


def _shared(name: str, group: type[Any] = ResultQuery) -> Any:
    """Return an option of a group for commands that take no more of it."""
    (field,) = (field for field in fields(group) if field.name == name)
    return typer.Option(**field.metadata["option"])


Scans = Annotated[
    Path | None, typer.Argument(metavar="SCANS", help=SCANS_HELP, show_default="the data set")
]
FORMATS = f"{' '.join(SCAN_SUFFIXES)}; of recordings: {' '.join(RECORDING_SUFFIXES)}"
SEVERAL_HELP = f"{SCANS_HELP} Several may be given, before OUT. Formats of scans: {FORMATS}."
SeveralScans = Annotated[
    Path | None, typer.Argument(metavar="SCANS...", help=SEVERAL_HELP, show_default="the data set")
]
RequiredScans = Annotated[Path, typer.Argument(metavar="SCANS", help=SCANS_HELP)]
LabelledDataSet = Annotated[
    Path,
    typer.Argument(
        metavar="DATASET",
        envvar=DATASET_VARIABLE,
        help="Labelled data set in SemanticKITTI's layout.",
    ),
]
Out = Annotated[
    Path, typer.Argument(metavar="OUT", envvar=OUT_VARIABLE, help="Folder for the results.")
]
WeightsOut = Annotated[
    Path, typer.Argument(metavar="WEIGHTS_OUT", help="Weights file to write (.safetensors).")
]
ByDistance = Annotated[
    bool, typer.Option("--by-distance", help="Also evaluate by distance from the sensor.")
]

topic_option = partial(
    typer.Option, help="Topic of the point clouds of a recording.", show_default="the only one"
)
TopicOfRecording = Annotated[str | None, topic_option()]
Topic = Annotated[str | None, topic_option(rich_help_panel="Selection")]
DataSet = Annotated[
    Path | None,
    selection_option(
        help="Data set in SemanticKITTI's layout.", envvar=DATASET_VARIABLE, show_default="."
    ),
]
DataSetOfResults = Annotated[Path | None, _shared("dataset")]
LabelSpaceName = Annotated[str | None, _shared("label_space")]
MergedInto = Annotated[str | None, _shared("classes")]
LabelledSelection = Annotated[
    ScanSelection,
    Shown(
        split={
            "help": "Only the sequences of this split: train or valid.",
            "show_default": "valid and the sequences of no split, without --sequences",
        },
        limit=EVENLY_SPACED,
    ),
]

Network = Annotated[NetworkSettings, Default(precision="auto")]
Device = Annotated[str, _shared("device", NetworkSettings)]
SensorWithoutWeights = Annotated[str | None, network_option(help=SENSOR_HELP, show_default="hdl64")]
Columns = Annotated[str | None, network_option(help=COLUMNS_HELP, show_default=COLUMNS_DEFAULT)]

jobs_option = partial(running_option, "--jobs", "-j", help="Number of processes; -1: one per core.")
Jobs = Annotated[int, jobs_option()]
Overwrite = Annotated[bool, running_option("--overwrite", help="Replace existing results.")]
Strict = Annotated[
    bool, running_option("--strict", help="End with status 1 if a scan or its labels are doubtful.")
]
Unsharded = Annotated[RunOptions, Without({"shard"})]
Reading = Annotated[RunOptions, Without({"shard", "overwrite"})]
"""For results over all scans, which several runs cannot share."""


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


def sensor(name: str | None) -> "Sensor | None":
    """Look up a sensor, None where none was named."""
    from salsanext_cli.sensors.sensor import sensor as find

    return None if name is None else find(name)


def source(scans: Path | None, dataset: Path | None, topic: str | None) -> Path:
    """Return where to look for scans: SCANS, else the data set or sequence here; or a topic."""
    here = any(Path(name).is_dir() for name in ("sequences", "velodyne"))
    if scans is None and dataset is None and not here:
        found = "not given, and the current folder is neither a data set nor a sequence"
        expected, hint = SCANS_HELP[0].lower() + SCANS_HELP[1:-1], "for those of this folder: ."
        raise UsageError("SCANS", found, expected, hint)
    return in_topic(scans or dataset or Path(), topic)


def sources(
    context: typer.Context, scans: Path | None, out: Path, dataset: Path | None, topic: str | None
) -> tuple[Path | list[Path], Path]:
    """Return where to look for scans, and OUT, which is the last word where several are given."""
    words = [*([scans] if scans else []), out, *map(Path, context.args)]
    several, out = words[:-1], words[-1]
    from salsanext_cli.files.reading import is_folder, present

    if present(out) and not is_folder(out):
        hint = "give it last: salsanext predict a.bin b.bin out/"
        raise UsageError("OUT", f"{out} is a file", "a folder for the results", hint)
    from salsanext_cli.results.paths import require_none_hidden

    if len(several) < 2:
        one = source(scans, dataset, topic)
        places = one.resolve(), out.resolve()
        # Results may lie beside the scans that they are of.
        if (
            scans is not None
            and out not in (one, *one.parents)
            and not any(a.is_relative_to(b) for a, b in (places, places[::-1]))
        ):
            require_none_hidden(out)
        return one, out
    if topic is not None:
        raise UsageError("--topic", f"{len(several)} sources", "one recording")
    require_none_hidden(out)
    return several, out


def in_topic(source: Path, topic: str | None) -> Path:
    """Return the path of a topic in a recording, of the recording where none is named."""
    if topic is None:
        return source
    from salsanext_cli.formats.recordings import is_recording

    if not is_recording(source):
        raise UsageError("--topic", f"{source} is no recording", "SCANS that are one")
    return source / topic.strip("/")


def share(option: str, text: str | None) -> float | None:
    """Return a share that is typed as 5% or 0.05; None for none."""
    try:
        percent = (text or "").endswith("%")
        return None if text is None else float(text.rstrip("%")) / (100 if percent else 1)
    except ValueError:
        raise UsageError(option, repr(text), "a share such as 5% or 0.05") from None
