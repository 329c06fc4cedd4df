# SPDX-License-Identifier: MIT
"""Formats of scan files by suffix: the built-in ones, and those of plug-ins.

The functions of a format are imported when they are first used, so that this table costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from salsanext_cli.errors import FormatError
from salsanext_cli.files.plug_ins import PlugIn, load_plug_ins

if TYPE_CHECKING:
    from salsanext_cli.formats.columns import Columns
    from salsanext_cli.records import Mask, Scan
    from salsanext_cli.sensors.sensor import Sensor

Names = tuple[str, ...]  # Of columns


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """Format of files of one scan each.

    Attributes
    ----------
    suffixes : tuple of str
        Suffixes of the files, in lower case, such as ``.pcd``; longer ones first.
    read : callable
        Reader: path, names of the columns (``--columns``, may be empty) and divisor of the
        intensity to `Scan`. It raises `FormatError` for a file that is not of the format.
    magic : tuple of bytes
        What the files begin with; empty if that varies.
    names_columns : bool
        Whether the files name their columns, so that ``--columns`` does not apply.
    is_table : bool
        Whether files with these suffixes often hold something else. Such files in a folder are
        scans only if there are no others.
    subset : callable, optional
        Writer of some points, for `filter`: path and names of the columns to a function from a
        mask (N,) bool to the content, bytes, of a file with the points that stay.
    label_columns : callable, optional
        Reader for `import-labels`: path to all columns, (N,) each, by name; x, y, z in metres.
    """

    suffixes: tuple[str, ...]
    read: Callable[[Path, Names, float], Scan]
    magic: tuple[bytes, ...] = ()
    names_columns: bool = True
    is_table: bool = False
    subset: Callable[[Path, Names], Callable[[Mask], bytes]] | None = None
    label_columns: Callable[[Path], Columns] | None = None


def _call(function: str, *arguments: Any) -> Any:
    """Import a function of this package, such as ``kitti:read_bin``, and call it."""
    module, _, name = function.partition(":")
    return getattr(import_module(f"{__name__}.{module}"), name)(*arguments)


def _lazy(function: str) -> Callable[..., Any]:
    return partial(_call, function)


def _of_columns(function: str, *, takes_names: bool = False) -> Callable[..., Scan]:
    """Return a reader that makes a scan of the columns that a function returns."""

    def read(path: Path, names: Names, intensity_scale: float) -> Scan:
        columns = _call(function, path, *([names] if takes_names else []))
        return _call("columns:scan_of", columns, path, intensity_scale)

    return read


FORMATS: Mapping[str, Format] = {
    "bin": Format(
        suffixes=(".pcd.bin.gz", ".bin.gz", ".pcd.bin", ".bin"),
        read=_lazy("kitti:read_bin"),
        names_columns=False,
        subset=_lazy("subsets:bin_subset"),
    ),
    "pcd": Format(
        suffixes=(".pcd",),
        magic=(b"# .PCD", b"VERSION "),
        read=_of_columns("pcd:pcd_columns"),
        subset=_lazy("subsets:pcd_subset"),
        label_columns=_lazy("pcd:pcd_columns"),
    ),
    "ply": Format(
        suffixes=(".ply",),
        magic=(b"ply",),
        read=_of_columns("ply:ply_columns"),
        subset=_lazy("subsets:ply_subset"),
        label_columns=_lazy("ply:ply_columns"),
    ),
    "las": Format(
        suffixes=(".las", ".laz"),
        magic=(b"LASF",),
        read=_lazy("las:read_las"),
        subset=_lazy("subsets:las_subset"),
        label_columns=_lazy("las:las_columns"),
    ),
    "xyz": Format(
        suffixes=(".xyz",),
        read=_of_columns("text:text_columns", takes_names=True),
        names_columns=False,
        subset=_lazy("subsets:text_subset"),
    ),
    "npy": Format(
        suffixes=(".npy",),
        magic=(b"\x93NUMPY",),
        read=_of_columns("numpy_scans:npy_columns", takes_names=True),
        names_columns=False,
        is_table=True,
        subset=_lazy("subsets:npy_subset"),
    ),
    "npz": Format(
        suffixes=(".npz",),
        magic=(b"PK\x03\x04",),
        read=_of_columns("numpy_scans:npz_columns", takes_names=True),
        names_columns=False,
        is_table=True,
        subset=_lazy("subsets:npz_subset"),
    ),
    "feather": Format(
        suffixes=(".feather",),
        magic=(b"ARROW1", b"FEA1"),
        read=_of_columns("feather:feather_columns"),
        is_table=True,
        subset=_lazy("subsets:feather_subset"),
    ),
    "text": Format(
        suffixes=(".csv", ".txt", ".asc", ".pts"),
        read=_of_columns("text:text_columns", takes_names=True),
        names_columns=False,
        is_table=True,
        subset=_lazy("subsets:text_subset"),
    ),
}
"""Built-in formats by name, in the order in which a folder is searched; plug-ins come last."""
SCAN_SUFFIXES = tuple(suffix for form in FORMATS.values() for suffix in form.suffixes)
"""Suffixes of the built-in formats."""
BAG_SUFFIXES = (".bag", ".mcap", ".db3")
RECORDING_SUFFIXES = (*BAG_SUFFIXES, ".pcap", ".osf")
"""Suffixes of recordings that are files."""
MAX_MAGIC_BYTES = 64


@cache
def plugged_formats() -> Mapping[str, PlugIn]:
    """Return the formats of plug-ins by name."""
    return load_plug_ins("formats", FORMATS, _fault)


def _fault(target: Any, others: Mapping[str, PlugIn]) -> str:
    """Return why an object is no further format, empty if it is one."""
    if not isinstance(target, Format):
        return f"it is a {type(target).__name__}, not a Format"
    taken = (*SCAN_SUFFIXES, *RECORDING_SUFFIXES)
    taken += tuple(suffix for other in others.values() for suffix in other.target.suffixes)
    for suffix in target.suffixes:
        if not suffix.startswith(".") or suffix != suffix.lower():
            return f"its suffix {suffix} is not in lower case, with a dot"
        if suffix.endswith(taken):
            return f"another format reads {suffix} files"
    return ""


def _by_suffix() -> Iterator[tuple[str, Format]]:
    """Yield suffixes and their formats; plug-ins are imported only if they are asked for."""
    for form in FORMATS.values():
        yield from ((suffix, form) for suffix in form.suffixes)
    for plug_in in plugged_formats().values():
        yield from ((suffix, plug_in.target) for suffix in plug_in.target.suffixes)


def suffixes_in_words(fits: Callable[[Format], object] = bool) -> str:
    """Return the suffixes of the formats that fit, those of plug-ins with their distribution."""
    words = [suffix for form in FORMATS.values() if fits(form) for suffix in form.suffixes]
    for plug_in in plugged_formats().values():
        suffixes = plug_in.target.suffixes if fits(plug_in.target) else ()
        words += [f"{suffix} ({plug_in.distribution})" for suffix in suffixes]
    return ", ".join(words)


def _known(name: str) -> tuple[str, Format | None]:
    lower = name.lower()
    # Scans of a recording have no suffix.
    pairs = _by_suffix() if "." in lower else ()
    return next((pair for pair in pairs if lower.endswith(pair[0])), ("", None))


def scan_suffix(name: str) -> str:
    """Return the suffix that makes a file a scan, in lower case; empty if it is none."""
    return _known(name)[0]


def format_of(name: str) -> Format | None:
    """Return the format of a file of some name; None if its suffix is unknown."""
    return _known(name)[1]


def is_table(name: str) -> bool:
    """Say whether a file of some name is a scan that often is something else."""
    form = format_of(name)
    return form is not None and form.is_table


def searched_suffixes(known: Collection[str]) -> Collection[str]:
    """Choose among the suffixes in a folder those of scans: all clouds, else tables of one kind."""
    in_order = [suffix for suffix in SCAN_SUFFIXES if suffix in known]
    in_order += sorted({*known} - {*in_order})
    return [suffix for suffix in in_order if not is_table(suffix)] or in_order[:1]


@contextmanager
def errors_of_plug_ins(path: Path) -> Iterator[None]:
    """Turn whatever a plug-in raises at a file into a `FormatError`."""
    from salsanext_cli.files.reading import refusing_damage

    if (suffix := scan_suffix(path.name)) in SCAN_SUFFIXES:
        yield
    else:
        with refusing_damage(path, f"a whole {suffix} file"):
            yield


def _plugged_kind(path: Path) -> PlugIn | None:
    """Return the format of a plug-in whose files begin as a file does, None if there is none."""
    from salsanext_cli.files.reading import reading

    with reading(path) as file:
        start = file.read(MAX_MAGIC_BYTES)
    plug_ins = plugged_formats().values()
    return next((each for each in plug_ins if start.startswith(each.target.magic)), None)


def read_scan(path: Path | str, sensor: Sensor | None = None) -> Scan:
    """Read a scan in the format that its suffix names, upper or lower case.

    Parameters
    ----------
    path : Path or str
        A file with the suffix of a format, or a scan of a recording as `find_scans` names it.
    sensor : Sensor, optional
        Its `intensity_scale` divides the intensity, except where the type of the values tells
        their range: bytes are divided by 255, those of LAS by 65535. Its `columns` name the
        columns of files that do not.

    Raises
    ------
    FormatError
        If the suffix is unknown or the file is not of that format.
    MissingDependency
        If the format needs a package that cannot be imported.
    """
    path = Path(path)
    scale = 1.0 if sensor is None else sensor.intensity_scale
    names = () if sensor is None else sensor.columns
    form = format_of(path.name)
    if form is None:
        if _call("recordings:recording_of", path) in (None, path):
            raise FormatError(path, "not a known scan format", f"a {suffixes_in_words()} file")
        return _of_columns("recordings:recorded_columns")(path, names, scale)
    try:
        with errors_of_plug_ins(path):
            return form.read(path, names, scale)
    except FormatError as error:
        other = _plugged_kind(path)
        if other and other.target is not form:
            remedy = f"rename it to {other.target.suffixes[0]}"
            raise FormatError(path, f"is a file of {other}", remedy=remedy) from error
        raise
