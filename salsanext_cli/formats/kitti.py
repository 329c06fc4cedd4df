# SPDX-License-Identifier: MIT
"""Headerless little-endian files of KITTI and nuScenes: scans, `.bin`, and labels, `.label`.

Files of anything but float32 points are refused. The right number of columns is evident from the
values: a column contains one kind of value, so the share of the variance that lies between columns
is largest for the right number and its multiples.
"""

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import RawIds
from salsanext_cli.errors import FormatError, LabelError, counted
from salsanext_cli.files.atomic import write_bytes
from salsanext_cli.files.reading import read_values, reading, size_of
from salsanext_cli.formats import FORMATS
from salsanext_cli.formats.columns import USUAL_COLUMNS, require_no_matrix, scan_of, unnamed_columns
from salsanext_cli.records import Double, Float, Mask, Scan, normalised_intensity
from salsanext_cli.sensors.sensor import UNUSED_COLUMN

COLUMNS = 4  # x, y, z in metres, remission
COLUMNS_WITH_RING = 5  # x, y, z, intensity, ring: the `.pcd.bin` files of nuScenes
REWRITE = "rewrite it as float32 x, y, z, intensity"
MAX_CLASS = 0xFFFF  # Largest label of four bytes without an instance


def read_bin(path: Path, columns: tuple[str, ...] = (), intensity_scale: float = 1.0) -> Scan:
    """Read a scan of float32 x, y, z, intensity and, in `.pcd.bin` files, ring, or of `columns`."""
    width = len(columns) or usual_width(path)
    values, size = _read_floats(path, width)
    count = evident_count(values, width)
    if count and are_coordinates(values[:, None]):
        raise _other_count(path, count, width)
    if size % (4 * width):
        hint = "copy it again, or convert it if it has other columns"
        raise FormatError(path, f"has {size} bytes", _multiple_of(width), hint)
    table = values.reshape(-1, width)
    if columns:
        scan = scan_of(unnamed_columns(table, columns, path), path, intensity_scale)
    else:
        points = np.ascontiguousarray(table[:, :3], np.float32)
        scan = Scan(points, normalised_intensity(table[:, 3], intensity_scale))
        require_no_matrix(points, path)
    if count or not are_coordinates(scan.points):
        problem = "contains numbers that are not float32, or not coordinates in metres"
        raise FormatError(path, problem, f"{width} float32 per point", REWRITE)
    return scan


def usual_width(path: Path) -> int:
    """Return the number of columns of a `.bin` file, 5 for `.pcd.bin`."""
    return COLUMNS_WITH_RING if path.name.lower().endswith(".pcd.bin") else COLUMNS


def _read_floats(path: Path, width: int) -> tuple[Float, int]:
    """Return the float32 values of a file of rows of `width`, and its size in bytes."""
    with reading(path) as file:
        if (size := size_of(file)) == 0:
            raise FormatError(path, "is empty", _multiple_of(width), "copy it again, or remove it")
        if kind := other_kind(file.read(TEXT_BYTES)):
            hint = f"rename it to {kind} if it contains points" if kind[0] == "." else REWRITE
            name = "text" if kind == TEXT_SUFFIX else f"a {kind} file" if kind[0] == "." else kind
            raise FormatError(path, f"is {name}", f"{width} float32 per point", hint)
        file.seek(0)
        values = read_values(file, path, "<f4", size // 4)
    if are_float64(values):
        raise FormatError(path, "contains float64", f"{width} float32 per point", REWRITE)
    return values, size


def _multiple_of(width: int) -> str:
    return f"a multiple of {4 * width}: {width} float32 per point"


def _other_count(path: Path, count: int, expected: int) -> FormatError:
    """Return the error of a file with another number of columns, with names to try."""
    names = ",".join((*USUAL_COLUMNS, *count * [UNUSED_COLUMN])[:count])
    hint = f"name its columns, for example with --columns {names}"
    if count == usual_width(path):
        hint = "omit --columns"
    elif suffix := {COLUMNS: ".bin", COLUMNS_WITH_RING: ".pcd.bin"}.get(count):
        hint = f"rename it to {suffix}, or {hint}"
    return FormatError(path, f"has {count} columns", f"{expected} float32 per point", hint)


def count_points(path: Path) -> int:
    """Return the number of points of a `.bin` file of four columns, from its size."""
    with reading(path) as file:
        return size_of(file) // (4 * COLUMNS)


def encode_bin(scan: Scan) -> bytes:
    """Return the content of a `.bin` file: float32 x, y, z, intensity of each point."""
    return np.column_stack([scan.points, scan.intensity]).astype("<f4", copy=False).tobytes()


def read_labels(path: Path, count: int | None = None) -> RawIds:
    """Read the raw ids of the points of a scan.

    Parameters
    ----------
    path : Path
        The `.label` file.
    count : int, optional
        Number of points of the scan; then labels of one or two bytes are recognised too.

    Returns
    -------
    (N,) uint32
        Class in the low 16 bits, instance in the high 16.

    Raises
    ------
    FormatError
        If the file cannot be read or is cut off.
    LabelError
        If there are not `count` labels.
    """
    with reading(path) as file:
        size = size_of(file)
        if size % 4 and (count is None or size not in (count, 2 * count)):
            expected = "a multiple of 4: one uint32 per point"
            raise FormatError(path, f"has {size} bytes", expected, "copy it again")
        raw = _labels(read_values(file, path, np.uint8, size), count or 0)
    if count is not None and len(raw) != count:
        expected = f"{count:,}, one per point of the scan"
        hint = "use the labels that belong to this scan"
        raise LabelError(path, f"has {counted(len(raw), 'label')}", expected, hint)
    return raw


def _labels(content: npt.NDArray[np.uint8], count: int) -> RawIds:
    """Return labels of two bytes or one if the size is that of `count`, else of four."""
    narrow = {2 * count: "<u2", count: "<u1"}.get(content.size)
    wide = content[: content.size // 4 * 4].view("<u4").astype(np.uint32, copy=False)
    # Classes of four bytes, without instances, of half or a quarter of the points.
    of_fewer = content.size % 4 == 0 and wide.any() and wide.max() <= MAX_CLASS
    if narrow is None or of_fewer:
        return wide
    return content.view(narrow).astype(np.uint32)


def encode_labels(raw: RawIds) -> bytes:
    """Return the content of a `.label` file: the raw id of each point as uint32."""
    return raw.astype("<u4", copy=False).tobytes()


def write_labels(path: Path, raw: RawIds) -> None:
    """Write the raw ids of the points of a scan.

    Parameters
    ----------
    path : Path
        The `.label` file.
    raw : (N,) integers
        Raw ids, written as uint32.
    """
    write_bytes(path, encode_labels(raw))


MAGIC = {
    **{magic: form.suffixes[0] for form in FORMATS.values() for magic in form.magic},
    b"\x1f\x8b": "a gzip file",
    b"#ROSBAG": ".bag",
    b"\x89MCAP0": ".mcap",
    b"ASTM-E57": "an E57 file",
    b"LASF": "a LAS file",
    b"\x00\x01\x00\x00": "a message of ROS 2",  # in CDR, little endian
}
"""Suffixes or names of other formats by their first bytes."""
TEXT_SUFFIX = ".csv"
TERRASCAN = b"\xa1\xce\x0e\x00CXYZ"  # Bytes 8 to 16 of files of TerraScan
TEXT_BYTES = 4096  # Size of the start of a file that shows whether it is text
MIN_TEXT_BYTES = 256  # Size from which float32 values contain bytes that do not occur in text
MIN_ASCII_BYTES = 16  # The same for ASCII, which is hardly ever coordinates in metres
CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f\x7f]")  # Bytes that do not occur in text
LEAST, MOST = 1e-12, 1e7
"""Possible magnitudes of values other than 0, in metres and in any unit of intensity and time."""
MIN_POSSIBLE_SHARE = 0.5  # Share of coordinates possible in any scan; random bytes have a quarter
MIN_POSSIBLE_SHARE_OF_LOW = 0.42
"""The same of every second float32; half of those of a planar scanner, z, are 0."""
MIN_POSSIBLE_SHARE_OF_FLOAT64 = 0.9
SAMPLE = 4096  # Rows that are examined, evenly spaced


def other_kind(start: bytes) -> str | None:
    """Return suffix or name of another format, or of text, by the first bytes; None without one."""
    of_magic = (kind for magic, kind in MAGIC.items() if start.startswith(magic))
    least = MIN_ASCII_BYTES if start.isascii() else MIN_TEXT_BYTES
    is_text = len(start) >= least and not CONTROL.search(start)
    other = TEXT_SUFFIX if is_text else "a TerraScan file" if start[8:16] == TERRASCAN else None
    return next(of_magic, other)


def are_float64(values: Float) -> bool:
    """Return whether float32 values (M,) of a file are the halves of float64 ones."""
    # Then most are possible as float64, and most low halves are impossible as float32: random bits
    # for rounded decimals; for former float32 one of eight values, six of which are impossible.
    if len(values) % 2:
        return False
    halves = np.ascontiguousarray(_sample(values.reshape(-1, 2)))
    halves = halves[halves.view("<u4").any(axis=1)]
    if not len(halves):
        return False
    possible = are_possible(halves.view("<f8")).mean() > MIN_POSSIBLE_SHARE_OF_FLOAT64
    return bool(possible and are_possible(halves[:, 0]).mean() < MIN_POSSIBLE_SHARE_OF_LOW)


def are_coordinates(values: Float) -> bool:
    """Return whether coordinates (N, 3) float32 can be metres, points at 0, NaN, inf aside."""
    rows = _sample(values)
    measured = rows[np.isfinite(rows) & (rows != 0)]
    return int(are_possible(measured).sum()) >= MIN_POSSIBLE_SHARE * len(measured)


def _sample(rows: Float) -> Float:
    return rows[:: len(rows) // SAMPLE | 1]  # An odd step meets all columns.


def are_possible(values: npt.NDArray[np.floating]) -> Mask:
    """Mark the magnitudes of measurements; 0 and NaN are none."""
    with np.errstate(invalid="ignore"):  # of a signalling NaN
        magnitudes = np.abs(values)
        return (magnitudes > LEAST) & (magnitudes < MOST)


COUNTS = range(3, 17)  # Numbers of columns that are distinguished
BLOCKS = 32  # Parts of a file that are examined, evenly spaced
ROWS, VALUES = 64, 128  # Rows of each for their order, and approximate values for their kinds
STEP_DEG = 5.0  # Largest difference in azimuth between consecutive measurements of a scanner
IN_TURN = 0.6
"""Least share of such points; real scans have 0.8 or more, wrong widths 0.34 or less."""
SHARE_OF_LARGEST = 0.6
"""Least share of the largest variance; the right number of columns has 0.97 or more."""
MIN_EXPLAINED, MIN_EXPLAINED_BY_CHANCE = 0.05, 40
"""Least explained variance for a decision; the second is divided by the number of values."""
MIN_VARIANCE = 0.005  # Least variance of a property that is examined
UNIT_TOLERANCE = 0.01  # Error in length of a normal
SAME_BEAM_RAD = 5e-4  # Angle between returns of one beam; adjacent beams are 1.5 mrad apart or more
MOVED_TOLERANCE_M = 0.005  # Error of a copy in another frame
MOST_ROWS = 0.9  # Share of rows that determines the columns of all
RANGE_LOG10 = 3.0  # Magnitudes count up to a factor of a thousand


def evident_count(values: Float, expected: int) -> int | None:
    """Return a number of columns that values (M,) evidently have instead of `expected`, or None."""
    if len(values) < 2 * max(expected, *COUNTS):
        return None
    count = expected
    if not _are_in_turn(values, expected):
        explained = {n: _explained(values, n) for n in {*COUNTS, expected}}
        most = max(explained.values())
        if most < MIN_EXPLAINED + MIN_EXPLAINED_BY_CHANCE / min(len(values), SAMPLE):
            return None
        if explained[expected] < SHARE_OF_LARGEST * most:
            # For beams in turn, explained variance grows with the number of rows taken as one.
            in_turn = (n for n in COUNTS if _are_in_turn(values, n))
            least = min(n for n in COUNTS if explained[n] >= SHARE_OF_LARGEST * most)
            count = next(in_turn, least)
    count = _padded_count(values, count) or _least_count(values, count)
    return None if count == expected else count


def _rows(values: Float, columns: int, length: int = ROWS) -> Double:
    """Return evenly spaced blocks of rows, (BLOCKS, length, columns), or all rows in one block."""
    rows = values[: len(values) // columns * columns].reshape(-1, columns)[None]
    if rows.shape[1] > BLOCKS * length:
        starts = np.linspace(0, rows.shape[1] - length, BLOCKS).astype(np.intp)
        rows = rows[0, starts[:, None] + np.arange(length)]
    with np.errstate(invalid="ignore"):  # of a signalling NaN
        return rows.astype(np.float64)


def _are_in_turn(values: Float, columns: int) -> bool:
    """Return whether rows of `columns` values are points in the order of a scanner's turn."""
    x, y = np.moveaxis(_rows(values, columns), -1, 0)[:2]
    azimuth = np.degrees(np.arctan2(y, x))
    measured = np.isfinite(azimuth) & ((x != 0) | (y != 0))
    # The few steps from one block to the next do not matter.
    steps = np.abs((np.diff(azimuth[measured]) + 180) % 360 - 180)
    return int((steps < STEP_DEG).sum()) > IN_TURN * max(1, int(steps.size))


def _least_count(values: Float, count: int) -> int:
    """Return the number of columns of one point, if `count` is a multiple of it."""
    for least in (n for n in COUNTS if n < count and count % n == 0):
        points = _rows(values, count).reshape(-1, count // least, least)
        measured = points[..., :2].any(axis=2).mean(axis=0)
        in_turn = measured.min() > measured.max() / 2 and _are_in_turn(values, least)
        alike = in_turn or _explained(values, least) > SHARE_OF_LARGEST * _explained(values, count)
        if alike and _are_of_two_points(*points[:, :2, :3].swapaxes(0, 1)):
            return least
    return count


def _are_of_two_points(first: Double, second: Double) -> bool:
    """Return whether values (N, 3) and the next ones of their rows are two points of a scan.

    They are not if the second ones are normals, returns of the same beams, or moved copies.
    """
    both = np.stack([first, second])
    both = both[:, (np.isfinite(both).all(axis=2) & both.any(axis=2)).all(axis=0)]
    first, second = both
    size = np.linalg.norm(second, axis=1)
    across = np.linalg.norm(np.cross(first, second), axis=1)
    is_normal = np.abs(size - 1) < UNIT_TOLERANCE
    is_same_beam = across <= SAME_BEAM_RAD * size * np.linalg.norm(first, axis=1)
    known = np.column_stack([first, np.ones(len(first))])
    moved = known @ np.linalg.lstsq(known, second, rcond=None)[0]
    is_moved = (np.abs(second - moved) < MOVED_TOLERANCE_M).all(axis=1)
    most = MOST_ROWS * len(second)
    return all(mask.sum() < most for mask in (is_normal, is_same_beam, is_moved))


def _padded_count(values: Float, columns: int) -> int | None:
    """Return the number of columns of a table with only zeros after the expected ones, or None."""
    for count in reversed(range(2 * columns, COUNTS.stop, columns)):
        sample = _rows(values, count)
        if not sample[..., columns:].any() and sample.any():
            return count
    return None


def _explained(values: Float, columns: int) -> float:
    """Return the share of the variance of sign, wholeness and magnitude between the columns."""
    sample = _rows(values, columns, VALUES // columns).reshape(-1, columns)
    size = np.where(np.isfinite(sample), np.abs(sample), 1.0)
    is_whole = (size > 0) & (sample == np.rint(sample))
    magnitude = np.log10(np.maximum(size, 10**-RANGE_LOG10)) / RANGE_LOG10
    properties = np.stack([sample < 0, is_whole, np.minimum(magnitude, 1)])
    within, total = properties.var(axis=1, ddof=1).mean(axis=1), properties.var(axis=(1, 2))
    vary = total > MIN_VARIANCE
    return float(np.mean(1 - within[vary] / total[vary])) if vary.any() else 0.0
