# SPDX-License-Identifier: MIT
"""Arguments and options of more than one command: scans, sensors and networks."""

from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from salsanext_cli.cli.expansion import Default, Shown, Without
from salsanext_cli.engines.settings import COLUMNS_DEFAULT, COLUMNS_HELP, NetworkSettings
from salsanext_cli.errors import UsageError
from salsanext_cli.formats import RECORDING_SUFFIXES, SCAN_SUFFIXES
from salsanext_cli.option_fields import ScanSelection
from salsanext_cli.parallel.run_options import RunOptions
from salsanext_cli.results.query import DATASET_VARIABLE, ResultQuery

if TYPE_CHECKING:
    from salsanext_cli.sensors.sensor import Sensor

OUT_VARIABLE = "SALSANEXT_OUT"
SCANS_HELP = "Scan file, folder of scans, sequence folder, data set or recording."
FORMATS = f"{' '.join(SCAN_SUFFIXES)}; of recordings: {' '.join(RECORDING_SUFFIXES)}"
SUBSET = {"names": ("--subset",), "help": "Only N scans, evenly spaced over the data."}
DEFAULT_SCANS = "the data set or sequence in the current folder"

network_option = partial(typer.Option, rich_help_panel="Network")
running_option = partial(typer.Option, rich_help_panel="Running")


def _shared(name: str, group: type[Any] = ResultQuery) -> Any:
    """Return one option of a group, for commands that take no other."""
    (field,) = (field for field in fields(group) if field.name == name)
    return typer.Option(**field.metadata["option"])


Scans = Annotated[
    Path | None, typer.Argument(metavar="SCANS", help=SCANS_HELP, show_default=DEFAULT_SCANS)
]
SeveralScans = Annotated[
    Path | None,
    typer.Argument(
        metavar="SCANS...",
        help=f"{SCANS_HELP} Several may be given. Formats of scans: {FORMATS}.",
        show_default=DEFAULT_SCANS,
    ),
]
RequiredScans = Annotated[Path, typer.Argument(metavar="SCANS", help=SCANS_HELP)]
LabelledDataSet = Annotated[
    Path,
    typer.Argument(
        metavar="DATASET",
        envvar=DATASET_VARIABLE,
        help="Labelled data set in the layout of SemanticKITTI.",
    ),
]
Out = Annotated[
    Path, typer.Argument(metavar="OUT", envvar=OUT_VARIABLE, help="Folder to write results to.")
]
Results = Annotated[
    Path,
    typer.Argument(
        metavar="OUT", envvar=OUT_VARIABLE, help="Folder with the results of earlier commands."
    ),
]
WeightsOut = Annotated[
    Path, typer.Argument(metavar="WEIGHTS_OUT", help="Weights file to write (.safetensors).")
]
Scale = Annotated[
    tuple[float, float] | None,
    typer.Option(
        metavar="LOW HIGH",
        help="Values at the ends of the colour map, for a single --colour.",
        show_default="the range of most values; fixed for error",
    ),
]
ByDistance = Annotated[
    bool, typer.Option("--by-distance", help="Also evaluate by distance from the sensor.")
]
Topic = Annotated[
    str | None,
    typer.Option(help="Topic in a recording with several topics.", rich_help_panel="Selection"),
]
DataSet = Annotated[
    Path | None,
    typer.Option(
        help="Data set in the layout of SemanticKITTI.",
        envvar=DATASET_VARIABLE,
        show_default="the current folder",
        rich_help_panel="Selection",
    ),
]
DataSetOfResults = Annotated[Path | None, _shared("dataset")]
LabelSpaceName = Annotated[str | None, _shared("label_space")]
MergedInto = Annotated[str | None, _shared("classes")]
LabelledSelection = Annotated[
    ScanSelection,
    Shown(split={"show_default": "valid, and the sequences of no split"}, limit=SUBSET),
]

Network = Annotated[NetworkSettings, Default(precision="auto")]
Device = Annotated[str, _shared("device", NetworkSettings)]
sensor_option = partial(network_option, help="Sensor of the scans.", metavar="NAME|FILE")
SensorWithoutWeights = Annotated[str | None, sensor_option(show_default="hdl64")]
columns_option = partial(network_option, help=COLUMNS_HELP, metavar="NAMES")
Columns = Annotated[str | None, columns_option(show_default=COLUMNS_DEFAULT)]

jobs_option = partial(
    running_option, "--jobs", "-j", help="Number of worker processes; -1: one per core."
)
Jobs = Annotated[int, jobs_option()]
Overwrite = Annotated[bool, running_option("--overwrite", help="Replace existing results.")]
Strict = Annotated[
    bool, running_option("--strict", help="Exit with status 1 after a warning about a scan.")
]
Unsharded = Annotated[RunOptions, Without({"shard"})]
Reading = Annotated[RunOptions, Without({"shard", "overwrite"})]
"""For results over all scans, which several runs cannot share."""


def sensor(name: str | None) -> "Sensor | None":
    """Look up a sensor; return None for no name."""
    from salsanext_cli.sensors.sensor import sensor as find

    return None if name is None else find(name)


def source(scans: Path | None, dataset: Path | None, topic: str | None) -> Path:
    """Return the source of the scans: SCANS, or the data set or sequence in the current folder."""
    is_here = any(Path(name).is_dir() for name in ("sequences", "velodyne"))
    if scans is None and dataset is None and not is_here:
        problem = "not given, and the current folder is neither a data set nor a sequence"
        expected = SCANS_HELP[0].lower() + SCANS_HELP[1:-1]
        raise UsageError("SCANS", problem, expected, "give . for the scans in this folder")
    return in_topic(scans or dataset or Path(), topic)


def sources(
    context: typer.Context, scans: Path | None, out: Path, dataset: Path | None, topic: str | None
) -> tuple[Path | list[Path], Path]:
    """Return the sources of the scans, and OUT, which is the last argument of several."""
    from salsanext_cli.files.reading import is_folder, present
    from salsanext_cli.results.paths import require_none_hidden

    words = [*([scans] if scans else []), out, *map(Path, context.args)]
    several, out = words[:-1], words[-1]
    if present(out) and not is_folder(out):
        hint = "give OUT last: salsanext predict a.bin b.bin out/"
        raise UsageError("OUT", f"{out} is a file", "a folder for the results", hint)
    if len(several) < 2:
        single = source(scans, dataset, topic)
        folders = single.resolve(), out.resolve()
        # Results may lie in the folder of their scans.
        is_apart = out not in (single, *single.parents) and not any(
            a.is_relative_to(b) for a, b in (folders, folders[::-1])
        )
        if scans is not None and is_apart:
            require_none_hidden(out)
        return single, out
    if topic is not None:
        raise UsageError("--topic", f"{len(several)} sources were given", "one recording")
    require_none_hidden(out)
    return several, out


def in_topic(source: Path, topic: str | None) -> Path:
    """Return the path of a topic in a recording, or of the recording itself."""
    if topic is None:
        return source
    from salsanext_cli.formats.recordings import is_recording

    if not is_recording(source):
        raise UsageError("--topic", f"{source} is not a recording", "a recording as SCANS")
    return source / topic.strip("/")


def share(option: str, text: str | None) -> float | None:
    """Return a share, 0…1, that is typed as ``5%`` or ``0.05``."""
    try:
        scale = 100 if (text or "").endswith("%") else 1
        return None if text is None else float(text.rstrip("%")) / scale
    except ValueError:
        raise UsageError(option, f"{text!r} is not a share", "5% or 0.05, for example") from None
