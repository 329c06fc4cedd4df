# SPDX-License-Identifier: MIT
"""Arguments and options of more than one command: scans, sensors and networks."""

from dataclasses import MISSING, dataclass, fields, replace
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, overload

import typer

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
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.notices import NOTICE, log_once
from salsanext_cli.core.texts import did_you_mean, with_hint
from salsanext_cli.core.uncertainty.kinds import UNCERTAINTY
from salsanext_cli.io.formats import SCAN_SUFFIXES
from salsanext_cli.io.formats.recording_kinds import RECORDING_SUFFIXES
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.query import DATASET_VARIABLE, ResultQuery

if TYPE_CHECKING:
    from salsanext_cli.core.records import Origin
    from salsanext_cli.core.sensors.sensor import Sensor

OUT_VARIABLE = "SALSANEXT_OUT"
SCANS_HELP = (
    "Scan file, folder of scans, sequence folder, data set, recording, or @FILE, a list of paths."
)
FORMATS = f"{' '.join(SCAN_SUFFIXES)}; of recordings: {' '.join(RECORDING_SUFFIXES)}"
SUBSET = DeclarationChange(names=("--subset",), help="Only N scans, evenly spaced over the data.")
"""Declaration of `ScanSelection.limit` in commands that spread the scans over the data."""
EXPECTED_SCANS = "scan file, folder of scans, sequence folder, data set, recording or @list.txt"
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
    "Print the scans to do, the sensor and the size; compute nothing.", default=False
)
STRICT = running_option("Exit with status 1 after a warning about a scan.", default=False)
Unsharded = Annotated[RunOptions, Without({"shard"})]
"""For results over all scans, which several runs cannot share."""
ReadOnlyRunOptions = Annotated[RunOptions, Without({"shard", "overwrite"})]
"""For commands over all scans that write no results."""


def sensor(name: str | None) -> "Sensor | None":
    """Look up a sensor; return None for no name."""
    from salsanext_cli.io.sensors import sensor as find

    return None if name is None else find(name)


def source(scans: Path | None, dataset: Path | None, topic: str | None) -> Path:
    """Return the source of the scans: SCANS, or the data set or sequence in the current folder."""
    is_here = any(Path(name).is_dir() for name in ("sequences", "velodyne"))
    if scans is None and dataset is None and not is_here:
        problem = "not given, and the current folder is neither a data set nor a sequence"
        raise UsageError("SCANS", problem, EXPECTED_SCANS, "give . for the scans in this folder")
    return in_topic(scans or dataset or Path(), topic)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScansAndOut:
    """Where a command reads its scans, and where it writes its results."""

    scans: Path | list[Path]  # One source, or several
    out: Path


def scans_and_out(
    context: typer.Context, scans: Path | None, out: Path, dataset: Path | None, topic: str | None
) -> ScansAndOut:
    """Return the sources of the scans, and OUT, which is the last argument of several.

    Parameters
    ----------
    context : typer.Context
        Its `args` are the paths after the second.
    scans : Path, optional
        First path that was typed.
    out : Path
        Second path that was typed, else the default of OUT.
    dataset : Path, optional
        Value of ``--dataset``.
    topic : str, optional
        Value of ``--topic``.

    Raises
    ------
    UsageError
        If there are no scans, or OUT is a file.
    OutputError
        If the results would hide scans that lie in OUT.
    """
    from salsanext_cli.runs.results.paths import require_no_hidden_scans

    paths = _typed_paths(context, scans, out)
    sources = paths[:-1]
    out = paths[-1]
    _require_folder(out)
    if len(sources) > 1:
        if topic is not None:
            raise UsageError("--topic", f"{len(sources)} sources were given", "one recording")
        require_no_hidden_scans(out)
        return ScansAndOut(scans=sources, out=out)
    single = source(scans, dataset, topic)
    if scans is not None:
        # Without SCANS, no OUT was typed that could be a wrong one.
        if _is_apart(out, single):
            require_no_hidden_scans(out)
        _notice_shared_folder(single, out)
    return ScansAndOut(scans=single, out=out)


def _typed_paths(context: typer.Context, scans: Path | None, out: Path) -> list[Path]:
    """Return all paths that were typed, in their order; the last one is OUT."""
    # Typer fills SCANS and OUT with the first two; the rest is in `context.args`.
    first = [] if scans is None else [scans]
    return [*first, out, *map(Path, context.args)]


def _require_folder(out: Path) -> None:
    """Refuse a file, or a list of scans, as OUT."""
    from salsanext_cli.io.files.reading import is_folder, present
    from salsanext_cli.runs.results.scan_list import list_of

    file_of_list = list_of(out)
    if file_of_list is not None and present(file_of_list):
        hint = f"give OUT last: salsanext predict {out} out/"
        raise UsageError("OUT", f"{out} is a list of scans", "a folder for the results", hint)
    if present(out) and not is_folder(out):
        hint = "give OUT last: salsanext predict a.bin b.bin out/"
        raise UsageError("OUT", f"{out} is a file", "a folder for the results", hint)


def _is_apart(out: Path, source: Path) -> bool:
    """Return whether results and scans are in different folders, neither inside the other."""
    # This needs no access to the disk, which may be slow.
    if out in (source, *source.parents):
        return False
    out_folder = out.resolve()
    source_folder = source.resolve()
    in_source = out_folder.is_relative_to(source_folder)
    return not in_source and not source_folder.is_relative_to(out_folder)


def _notice_shared_folder(source: Path, out: Path) -> None:
    """Print a notice if the results are written into the folder of the scans."""
    from salsanext_cli.io.files.reading import is_folder
    from salsanext_cli.runs.fit.range_images import projected_sensor

    out_folder = out.resolve()
    source_folder = source.resolve()
    problem = ""
    if out_folder == source_folder:
        if projected_sensor(source) is None:
            problem = "is given as SCANS and as OUT, so the results go into the folder of the scans"
    elif out_folder.is_relative_to(source_folder) and not is_folder(source / "sequences"):
        problem = "is inside the folder of the scans"
    if problem:
        hint = "give another folder as OUT to separate scans and results"
        log_once(with_hint(f"{out}: {problem}", hint), NOTICE)


def in_topic(source: Path, topic: str | None) -> Path:
    """Return the path of a topic in a recording, or of the recording itself."""
    if topic is None:
        return source
    from salsanext_cli.io.formats.recordings import is_recording

    if not is_recording(source):
        raise UsageError("--topic", f"{source} is not a recording", "a recording as SCANS")
    return source / topic.strip("/")


@overload
def share(option: str, text: str, word: str = "") -> float: ...
@overload
def share(option: str, text: str | None, word: str = "") -> float | None: ...
def share(option: str, text: str | None, word: str = "") -> float | None:
    """Return a share of at most 1 that is typed as ``5%`` or ``0.05``; stages check its range.

    `word`: what the option takes besides a share, for the error.
    """
    if text is None:
        return None
    number = text.removesuffix("%")
    try:
        value = float(number)
    except ValueError:
        problem = f"{text!r} is not a share"
        expected = "5% or 0.05, for example"
        hint = ""
        if word:
            problem = f"{problem} and not {word}"
            expected = f"a share such as 5% or 0.05, or {word}"
            hint = did_you_mean(text, [word])
        raise UsageError(option, problem, expected, hint) from None
    fraction = value / 100 if text.endswith("%") else value
    if fraction > 1:
        hint = f"did you mean {number}%?" if 1 < value <= 100 else ""
        problem = f"{text} is {100 * fraction:g} %"
        raise UsageError(option, problem, "a share of at most 100%", hint)
    return fraction


def position(option: str, text: str | None) -> "Origin | None":
    """Return a position in metres, which is typed as ``500100,5400020,312``; None for no text."""
    if text is None:
        return None
    try:
        numbers = tuple(float(number) for number in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 3 or not all(isfinite(number) for number in numbers):
        hint = f"for example {option} 500100,5400020,312"
        raise UsageError(option, f"is {text!r}", "three numbers in metres: x,y,z", hint)
    return numbers
