# SPDX-License-Identifier: MIT
"""Formats of scan files by suffix: built-in ones and plug-ins.

A reader, `Format.read`, returns a `Scan`. Readers of files with named columns first collect
`Columns`, arrays (N,) by the names of the file, and return `columns.scan_of(columns, path, …)`.
`Columns` must hold numbers named x, y and z, in metres unless the name states another unit; the
intensity is the usual name among the others, and 0 without any. `Format.label_columns` returns the
`Columns` of a file themselves, with its labels.

The functions of a built-in format are imported when they are first used.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.wording import argument
from salsanext_cli.io.formats.recording_kinds import RECORDING_SUFFIXES

if TYPE_CHECKING:
    from salsanext_cli.core.plug_ins import PlugIn
    from salsanext_cli.core.records import Mask, Scan
    from salsanext_cli.core.sensors.sensor import Sensor
    from salsanext_cli.io.formats.columns import Columns

Names = tuple[str, ...]  # Of columns


@dataclass(frozen=True, slots=True)
class Format:
    """Format of files of one scan each.

    Attributes
    ----------
    suffixes : tuple of str
        Suffixes of the files, in lower case, such as ``.pcd``; longer ones first.
    read : callable
        Reader: path, names of the columns (may be empty) and divisor of the intensity to `Scan`.
        It raises `FormatError` for a file of another format. Readers of this package also take
        the name of the column with the intensity (`Sensor.intensity_field`).
    magic : tuple of bytes
        First bytes of the files; empty if they vary.
    is_table : bool
        Whether files with these suffixes often contain something else. Such files in a folder
        are scans only if it has no others.
    subset : callable, optional
        Writer of some points, for `filter`: path and names of the columns to a function from a
        mask (N,) bool of the remaining points to the content, bytes, of a file.
    label_columns : callable, optional
        Reader for `import-labels`: path to all columns, (N,) each, by name; x, y, z in metres.
    """

    suffixes: tuple[str, ...]
    read: Callable[[Path, Names, float], Scan]
    magic: tuple[bytes, ...] = ()
    is_table: bool = False
    subset: Callable[[Path, Names], Callable[[Mask], bytes]] | None = None
    label_columns: Callable[[Path], Columns] | None = None


def _imported(module: str, name: str) -> Callable[..., Any]:
    """Return a function of a module of this package, which is imported at the first call."""
    return partial(_call, module, name)


def _call(module: str, name: str, *arguments: Any) -> Any:
    function: Callable[..., Any] = getattr(import_module(f"{__name__}.{module}"), name)
    return function(*arguments)


def _reader_of_columns(module: str, name: str) -> Callable[..., Scan]:
    """Return the reader of scans by a function that reads columns."""
    return partial(_read_columns, module, name)


def _read_columns(
    module: str,
    name: str,
    path: Path,
    names: Names,
    intensity_scale: float,
    intensity_field: str = "",
) -> Scan:
    columns = _call(module, name, path, names)
    return _call("columns", "scan_of", columns, path, intensity_scale, intensity_field)


FORMATS: Mapping[str, Format] = {
    "bin": Format(
        suffixes=(".pcd.bin", ".bin"),
        read=_imported("kitti", "read_bin"),
        subset=_imported("subsets", "bin_subset"),
    ),
    "pcd": Format(
        suffixes=(".pcd",),
        read=_imported("pcd", "read_pcd"),
        magic=(b"# .PCD", b"VERSION "),
        subset=_imported("subsets", "pcd_subset"),
        label_columns=_imported("pcd", "pcd_columns"),
    ),
    "ply": Format(
        suffixes=(".ply",),
        read=_reader_of_columns("ply", "ply_columns"),
        magic=(b"ply",),
        subset=_imported("subsets", "ply_subset"),
        label_columns=_imported("ply", "ply_columns"),
    ),
    "las": Format(
        suffixes=(".las", ".laz"),
        read=_imported("survey.las_scan", "read_las"),
        magic=(b"LASF",),
        subset=_imported("survey.las_subset", "las_subset"),
        label_columns=_imported("survey.las_file", "las_columns"),
    ),
    "xyz": Format(
        suffixes=(".xyz",),
        read=_imported("tables.text", "read_text"),
        subset=_imported("subsets", "text_subset"),
    ),
    "npy": Format(
        suffixes=(".npy",),
        read=_reader_of_columns("npy", "npy_columns"),
        magic=(b"\x93NUMPY",),
        is_table=True,
        subset=_imported("subsets", "npy_subset"),
    ),
    "npz": Format(
        suffixes=(".npz",),
        read=_reader_of_columns("npy", "npz_columns"),
        magic=(b"PK\x03\x04",),
        is_table=True,
        subset=_imported("subsets", "npz_subset"),
    ),
    "feather": Format(
        suffixes=(".feather",),
        read=_reader_of_columns("tables.arrow", "feather_columns"),
        magic=(b"ARROW1", b"FEA1"),
        is_table=True,
        subset=_imported("tables.arrow", "feather_subset"),
    ),
    "parquet": Format(
        suffixes=(".parquet",),
        read=_reader_of_columns("tables.arrow", "parquet_columns"),
        magic=(b"PAR1",),
        is_table=True,
    ),
    "text": Format(
        suffixes=(".csv", ".txt", ".asc", ".pts"),
        read=_imported("tables.text", "read_text"),
        is_table=True,
        subset=_imported("subsets", "text_subset"),
    ),
}
"""Built-in formats by name, in the order of precedence in a folder; plug-ins come last."""
SCAN_SUFFIXES = tuple(suffix for form in FORMATS.values() for suffix in form.suffixes)
"""Suffixes of the built-in formats."""
OTHER_SUFFIXES = (".label", ".json", ".jsonl", ".toml", ".yaml", ".yml", ".md", ".safetensors")
"""Suffixes that plug-ins cannot have, beside those of scans and recordings."""
MAX_MAGIC_BYTES = 64


@cache
def plugged_formats() -> Mapping[str, PlugIn]:
    """Return the formats of plug-ins by name."""
    from salsanext_cli.core.plug_ins import load_plug_ins

    return load_plug_ins("formats", FORMATS, Format, _fault)


def _fault(target: Format, others: Collection[PlugIn]) -> str:
    """Return why a format cannot be added to others; empty if it can."""
    taken = SCAN_SUFFIXES + RECORDING_SUFFIXES + OTHER_SUFFIXES
    for other in others:
        taken += other.target.suffixes
    wrong = [s for s in target.suffixes if s[:1] != "." or s != s.lower() or s.endswith(taken)]
    return f"its suffix {wrong[0]} is taken, or not in lower case with a dot" if wrong else ""


def _find(name: str) -> tuple[str, Format | None]:
    """Return suffix and format of a file name; import plug-ins only if no built-in fits."""
    lower = name.lower()
    for form in FORMATS.values():
        suffix = _suffix_among(form.suffixes, lower)
        if suffix:
            return suffix, form
    # Scans of a recording have no suffix.
    for plug_in in plugged_formats().values() if "." in lower else ():
        suffix = _suffix_among(plug_in.target.suffixes, lower)
        if suffix:
            return suffix, plug_in.target
    return "", None


def _suffix_among(suffixes: Sequence[str], name: str) -> str:
    """Return the first of the suffixes that a name has; empty for none."""
    return next((suffix for suffix in suffixes if name.endswith(suffix)), "")


def scan_suffix(name: str) -> str:
    """Return the suffix, in lower case, of the format of a file name; empty without a format."""
    return _find(name)[0]


def format_of(name: str) -> Format | None:
    """Return the format of a file name; None if its suffix is unknown."""
    return _find(name)[1]


def is_table(name: str) -> bool:
    """Return whether the format of a file name is a table (`Format.is_table`)."""
    form = format_of(name)
    return form is not None and form.is_table


def suffixes_in_words(fits: Callable[[Format], object] = bool) -> str:
    """Return the suffixes of the formats that fit; those of plug-ins name the distribution."""
    words = [suffix for form in FORMATS.values() if fits(form) for suffix in form.suffixes]
    for plug_in in plugged_formats().values():
        suffixes = plug_in.target.suffixes if fits(plug_in.target) else ()
        words += [f"{suffix} ({plug_in.distribution})" for suffix in suffixes]
    return ", ".join(words)


@contextmanager
def errors_of_plug_ins(path: Path) -> Iterator[None]:
    """Turn any exception of a plug-in that reads a file into a `FormatError`."""
    from salsanext_cli.io.files.reading import refusing_damage

    suffix = scan_suffix(path.name)
    guard = refusing_damage(path, f"a complete {suffix} file")
    with nullcontext() if suffix in SCAN_SUFFIXES else guard:
        yield


def _plugged_kind(path: Path) -> PlugIn | None:
    """Return the plugged format whose magic bytes a file begins with; None without one."""
    from salsanext_cli.io.files.reading import reading

    with reading(path) as file:
        start = file.read(MAX_MAGIC_BYTES)
    plug_ins = plugged_formats().values()
    return next((p for p in plug_ins if start.startswith(p.target.magic)), None)


def _read(form: Format, path: Path, names: Names, scale: float, field: str) -> Scan:
    """Read a scan; only built-in formats take the name of the intensity."""
    if not field:
        return form.read(path, names, scale)
    if form not in FORMATS.values():
        hint = f"omit {argument('intensity_field')}"
        raise FormatError(path, "is of a plug-in, which chooses the intensity by itself", hint=hint)
    reader: Callable[..., Scan] = form.read
    return reader(path, names, scale, field)


def read_scan(path: Path | str, sensor: Sensor | None = None) -> Scan:
    """Read a scan in the format that its suffix names, upper or lower case.

    Parameters
    ----------
    path : Path or str
        A file with the suffix of a format, or a scan of a recording as `find_scans` names it.
    sensor : Sensor, optional
        Its `intensity_scale` divides the intensity, except bytes, which are divided by 255. Its
        `columns` name the columns of files without names, and its `intensity_field` the column
        with the intensity.

    Returns
    -------
    Scan
        N points, in the order of the file.

    Raises
    ------
    FormatError
        If the suffix is unknown or the file is damaged.
    MissingDependency
        If the format needs a package that cannot be imported.
    """
    path = Path(path)
    scale = 1.0 if sensor is None else sensor.intensity_scale
    names = () if sensor is None else sensor.columns
    field = "" if sensor is None else sensor.intensity_field
    form = format_of(path.name)
    if form is None:
        if _call("recordings", "recording_of", path) in (None, path):
            raise FormatError(path, "unknown scan format", f"a {suffixes_in_words()} file")
        return _call("recordings", "recorded_scan", path, scale, field)
    try:
        with errors_of_plug_ins(path):
            scan = _read(form, path, names, scale, field)
            if not isinstance(scan, import_module("salsanext_cli.core.records").Scan):
                raise TypeError(f"its reader returned a {type(scan).__name__}, not a Scan")
            return scan
    except FormatError as error:
        other = _plugged_kind(path)
        if other and other.target is not form:
            hint = f"rename it to {other.target.suffixes[0]}"
            raise FormatError(path, f"is a file of plug-in {other}", hint=hint) from error
        raise
