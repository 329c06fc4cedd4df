# SPDX-License-Identifier: MIT
"""Arguments and options of more than one command: scans, sensors and networks."""

from dataclasses import MISSING, fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from salsanext_cli.commands.line.options.expansion import Default, Without
from salsanext_cli.commands.line.options.option_fields import (
    DeclarationChange,
    argument,
    declared_field,
    network_option,
    option,
    running_option,
    selection_option,
)
from salsanext_cli.commands.line.options.option_groups import OPTIONS
from salsanext_cli.core.uncertainty.kinds import UNCERTAINTY
from salsanext_cli.io.formats import SCAN_SUFFIXES
from salsanext_cli.io.formats.recording_kinds import RECORDING_SUFFIXES
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.query import DATASET_VARIABLE, ResultQuery

OUT_VARIABLE = "SALSANEXT_OUT"
SCANS_HELP = (
    "Scan file, folder of scans, sequence folder, data set, recording, or @FILE, a list of paths."
)
FORMATS = f"{' '.join(SCAN_SUFFIXES)}; of recordings: {' '.join(RECORDING_SUFFIXES)}"
SUBSET = DeclarationChange(names=("--subset",), help="Only N scans, evenly spaced over the data.")
"""Declaration of `ScanSelection.limit` in commands that spread the scans over the data."""
DEFAULT_SCANS = "the data set or sequence in the current folder"


def _option_of(
    record: type[Any], field_name: str, *, default: Any = MISSING, show_default: str | None = None
) -> Any:
    """Return the option of one field of a record, for a command that takes no other of its fields.

    Parameters
    ----------
    record : type
        The record.
    field_name : str
        Name of its field. The command gets the text that was typed, also if the field has a
        `parse`.
    default : object, optional
        Default of the option; by default that of the field.
    show_default : str, optional
        Default in words; by default as of the field.
    """
    if default is MISSING:
        default = next(field.default for field in fields(record) if field.name == field_name)
    declaration = replace(OPTIONS[record][field_name], parse=None)
    changed = declaration.changed(DeclarationChange(show_default=show_default))
    return declared_field(changed, default)


SCANS = argument(SCANS_HELP, metavar="SCANS", show_default=DEFAULT_SCANS)
SEVERAL_SCANS = argument(
    f"{SCANS_HELP} Several may be given. Formats of scans: {FORMATS}.",
    metavar="SCANS...",
    show_default=DEFAULT_SCANS,
)
labelled_argument = partial(
    argument,
    "Labelled data set in the layout of SemanticKITTI.",
    metavar="DATASET",
    envvar=DATASET_VARIABLE,
)
NEW_DATASET = argument("Root of the data set to write.", default=..., metavar="DATASET")
folder_argument = partial(argument, default=Path("out"), metavar="OUT", envvar=OUT_VARIABLE)
OUT = folder_argument("Folder to write results to.")
RESULTS = folder_argument("Folder with the results of earlier commands.")
WEIGHTS_OUT = argument("Weights file to write (.safetensors).", default=..., metavar="WEIGHTS_OUT")
COLOUR_HELP = (
    "label, truth, wrong, intensity, range, uncertainty, or one kind of it: "
    f"{', '.join(UNCERTAINTY)}"
)
SCALE = option(
    "Values at the ends of the colour map, for a single --colour.",
    metavar="LOW HIGH",
    show_default="the range of most values; fixed for error",
)
TOPIC = selection_option("Topic in a recording with several topics.")
DATASET = selection_option(
    "Data set in the layout of SemanticKITTI.",
    envvar=DATASET_VARIABLE,
    show_default="the current folder",
)
DATASET_OF_RESULTS = _option_of(ResultQuery, "dataset")
LABEL_SPACE = _option_of(ResultQuery, "label_space")
CLASSES = _option_of(ResultQuery, "classes")
DEVICE = _option_of(NetworkSettings, "device")
Network = Annotated[NetworkSettings, Default(precision="auto")]
sensor_option = partial(network_option, "Sensor of the scans.", metavar="NAME|FILE")
SENSOR = sensor_option(show_default="hdl64")
columns_option = partial(_option_of, NetworkSettings, "columns")
COLUMNS = columns_option()
ORIGIN = network_option(
    "Position of the sensor in the coordinates of the files, in metres, if nothing shows it, as in "
    "a survey.",
    metavar="X,Y,Z",
    show_default="fitted to the scans",
)
INTENSITY_FIELD = _option_of(NetworkSettings, "intensity_field")
jobs_option = partial(_option_of, RunOptions, "jobs")
JOBS = jobs_option()
CLUSTER = _option_of(RunOptions, "cluster")
OVERWRITE = _option_of(RunOptions, "overwrite")
DRY_RUN = running_option(
    "Print what the command would do, and the size of its results; write nothing.", default=False
)
STRICT = running_option("Exit with status 1 after a warning about a scan.", default=False)
Unsharded = Annotated[RunOptions, Without({"shard"})]
"""For results over all scans, which several runs cannot share."""
ReadOnlyRunOptions = Annotated[RunOptions, Without({"shard", "overwrite"})]
"""For commands over all scans that write no results."""
