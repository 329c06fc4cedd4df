# SPDX-License-Identifier: MIT
"""Files of KITTI and nuScenes, little endian, without header: scans, `.bin`, and labels, `.label`.

What cannot be float32 records of points is refused, as its values tell: those that are a row apart
are of one kind, coordinates, intensities, beams. So the share of the variance that lies between the
columns of a table is largest for the right number of columns and its multiples; read with another
number, every column holds a mixture.
"""

import gzip
import re
from io import BufferedIOBase, BytesIO
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import RawIds
from salsanext_cli.errors import FormatError, LabelError, counted
from salsanext_cli.files.atomic import write_bytes
from salsanext_cli.files.reading import read_values, reading, refusing_damage, size_of
from salsanext_cli.formats import FORMATS
from salsanext_cli.formats.columns import USUAL_COLUMNS, require_no_matrix, scan_of, unnamed_columns
from salsanext_cli.records import Double, Float, Mask, Scan, normalised_intensity
from salsanext_cli.sensors.sensor import UNUSED_COLUMN

COLUMNS = 4  # x, y, z in metres, remission
COLUMNS_WITH_RING = 5  # x, y, z, intensity, ring: the `.pcd.bin` files of nuScenes
GZIP_SUFFIX = ".gz"
MAX_DECOMPRESSED_BYTES = 1 << 28  # Sixteen million points
REWRITE = "write it again as float32 x, y, z, intensity"
MAX_CLASS = 0xFFFF  # Largest label of four bytes without an instance


def read_bin(path: Path, columns: tuple[str, ...] = (), intensity_scale: float = 1.0) -> Scan:
    """Read a scan of float32 x, y, z, intensity and, in `.pcd.bin` files, ring, or of `columns`."""
    width = len(columns) or usual_width(path)
    values, size = _read_floats(path, width)
    count = evident_count(values, width)
    if count and are_coordinates(values[:, None]):
        raise _other_count(path, count, width)
    if size % (4 * width):
        hint = "it is cut off or of another kind"
        raise FormatError(path, f"{size} bytes", _expected(width), hint)
    table = values.reshape(-1, width)
    if columns:
        scan = scan_of(unnamed_columns(table, columns, path), path, intensity_scale)
    else:
        scan = Scan(
            np.ascontiguousarray(table[:, :3], np.float32),
            normalised_intensity(table[:, 3], intensity_scale),
        )
    if count or not are_coordinates(scan.points):
        found = "numbers that are no coordinates in metres, or no float32"
        raise FormatError(path, found, f"{width} float32 per point", REWRITE)
    if len(scan) in (3, 4):
        require_no_matrix(scan.points, path)
    return scan


def usual_width(path: Path) -> int:
    """Return the number of columns of a `.bin` file, 5 for `.pcd.bin`."""
    has_ring = path.name.lower().removesuffix(GZIP_SUFFIX).endswith(".pcd.bin")
    return COLUMNS_WITH_RING if has_ring else COLUMNS


def _read_floats(path: Path, width: int) -> tuple[Float, int]:
    """Read all float32 of a file of rows of so many, if it may be one; also return its size."""
    with reading(path) as opened:
        file: BufferedIOBase = opened
        size = size_of(opened)
        if size and path.name.lower().endswith(GZIP_SUFFIX):
            file, size = decompressed(opened, path)
        if size == 0:
            raise FormatError(path, "is empty", _expected(width), "copy it again, or remove it")
        if kind := other_kind(file.read(TEXT_BYTES)):
            hint = f"rename it to {kind} if it holds points" if kind[0] == "." else REWRITE
            found = "text" if kind == TEXT_SUFFIX else f"a {kind} file" if kind[0] == "." else kind
            raise FormatError(path, f"is {found}", f"{width} float32 per point", hint)
        file.seek(0)
        values = read_values(file, path, "<f4", size // 4)
    if are_float64(values):
        raise FormatError(path, "holds float64", f"{width} float32 per point", REWRITE)
    return values, size


def decompressed(file: BufferedIOBase, path: Path) -> tuple[BytesIO, int]:
    """Return content and size of a gzip file, of `MAX_DECOMPRESSED_BYTES` at most."""
    with refusing_damage(path, "a .bin file, compressed by gzip", "copy it again"):
        content = gzip.GzipFile(fileobj=file).read(MAX_DECOMPRESSED_BYTES + 1)
    if len(content) > MAX_DECOMPRESSED_BYTES:
        found = f"more than {MAX_DECOMPRESSED_BYTES >> 20} MiB when decompressed"
        raise FormatError(path, found, "one scan", "decompress it, or split it into scans")
    return BytesIO(content), len(content)


def _expected(width: int) -> str:
    return f"a multiple of {4 * width} ({width} float32 per point)"


def _other_count(path: Path, count: int, expected: int) -> FormatError:
    """Return the error of a file of another number of columns, with names to try."""
    names = ",".join((*USUAL_COLUMNS, *count * [UNUSED_COLUMN])[:count])
    hint = f"name its columns, with --columns {names} for example"
    if count == usual_width(path):
        hint = "leave --columns out"
    elif suffix := {COLUMNS: ".bin", COLUMNS_WITH_RING: ".pcd.bin"}.get(count):
        hint = f"give it the suffix {suffix}, or {hint}"
    return FormatError(path, f"holds {count} columns", f"{expected} float32 per point", hint)


def count_points(path: Path) -> int:
    """Return the number of points of a `.bin` file of four columns, from its size."""
    with reading(path) as file:
        return size_of(file) // (4 * COLUMNS)


def encode_bin(scan: Scan) -> bytes:
    """Return the content of a `.bin` file: float32 x, y, z, intensity of each point."""
    return np.column_stack([scan.points, scan.intensity]).astype("<f4", copy=False).tobytes()


def read_labels(path: Path, count: int | None = None) -> RawIds:
    """Read the raw ids of a scan's points, (N,) uint32.

    Parameters
    ----------
    path : Path
        The `.label` file.
    count : int, optional
        Number of points of the scan; then two bytes or one per label are recognised too.

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
            expected = "a multiple of 4 (one uint32 per point)"
            raise FormatError(path, f"{size} bytes", expected, "it is cut off")
        raw = _labels(read_values(file, path, np.uint8, size), count or 0)
    if count is not None and len(raw) != count:
        expected = f"{count:,}, one per point of the scan"
        hint = "use the labels that belong to this scan"
        raise LabelError(path, counted(len(raw), "label"), expected, hint)
    return raw


def _labels(content: npt.NDArray[np.uint8], count: int) -> RawIds:
    """Return labels of two bytes or one where so many are so long, else of four."""
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
    """Write the raw ids of a scan's points, (N,) integer, as uint32."""
    write_bytes(path, encode_labels(raw))


MAGIC = {
    **{magic: form.suffixes[0] for form in FORMATS.values() for magic in form.magic},
    b"\x1f\x8b": ".bin.gz",
    b"#ROSBAG": ".bag",
    b"\x89MCAP0": ".mcap",
    b"ASTM-E57": "an E57 file",
    b"\x00\x01\x00\x00": "a message of ROS 2",  # in CDR, little endian
}
"""Suffixes or names of other formats by the bytes that their files begin with."""
TEXT_SUFFIX = ".csv"
TERRASCAN = b"\xa1\xce\x0e\x00CXYZ"  # Bytes 8 to 16 of files of TerraScan
TEXT_BYTES = 4096  # Size of the start of a file that shows whether it is text
MIN_TEXT_BYTES = 256  # Size from which float32 values hold bytes that do not occur in text
MIN_ASCII_BYTES = 16  # The same for ASCII, which is hardly ever coordinates in metres
CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f\x7f]")  # Bytes that do not occur in text
LEAST, MOST = 1e-12, 1e7
"""Possible magnitudes of values other than 0, in metres and in any unit of intensity and time."""
MIN_POSSIBLE_SHARE = 0.5  # Share of coordinates possible in any scan; random bytes have a quarter
MIN_POSSIBLE_SHARE_OF_LOW = 0.42
"""The same of every second float32, of which a scanner of one plane has half, z, equal to 0."""
MIN_POSSIBLE_SHARE_OF_FLOAT64 = 0.9
SAMPLE = 4096  # Rows that are looked at, evenly spaced


def other_kind(start: bytes) -> str | None:
    """Return the suffix or name of the format that a file begins as, or of text, else None."""
    of_magic = (kind for magic, kind in MAGIC.items() if start.startswith(magic))
    least = MIN_ASCII_BYTES if start.isascii() else MIN_TEXT_BYTES
    is_text = len(start) >= least and not CONTROL.search(start)
    other = TEXT_SUFFIX if is_text else "a TerraScan file" if start[8:16] == TERRASCAN else None
    return next(of_magic, other)


def are_float64(values: Float) -> bool:
    """Say whether float32 values (M,) of a file are the halves of float64 ones."""
    # Then most are possible as float64, and most of the low halves are not as float32: of rounded
    # decimals they are random; of former float32 they have eight values, six of them impossible.
    if len(values) % 2:
        return False
    halves = np.ascontiguousarray(_sample(values.reshape(-1, 2)))
    halves = halves[halves.view("<u4").any(axis=1)]
    if not len(halves):
        return False
    possible = are_possible(halves.view("<f8")).mean()
    possible_low = are_possible(halves[:, 0]).mean()
    return bool(
        possible > MIN_POSSIBLE_SHARE_OF_FLOAT64 and possible_low < MIN_POSSIBLE_SHARE_OF_LOW
    )


def are_coordinates(values: Float) -> bool:
    """Say whether coordinates (N, 3) float32 can be metres, for all that are a measurement."""
    rows = _sample(values)
    measured = rows[np.isfinite(rows) & (rows != 0)]
    return int(are_possible(measured).sum()) >= MIN_POSSIBLE_SHARE * len(measured)


def _sample(rows: Float) -> Float:
    # An odd step meets all columns.
    return rows[:: len(rows) // SAMPLE | 1]


def are_possible(values: npt.NDArray[np.floating]) -> Mask:
    """Mark the magnitudes that a measurement may have; 0 and NaN are none."""
    # A NaN may signal.
    with np.errstate(invalid="ignore"):
        magnitudes = np.abs(values)
        return (magnitudes > LEAST) & (magnitudes < MOST)


COUNTS = range(3, 17)  # Numbers of columns that are told apart
BLOCKS = 32  # Places of a file that are looked at, evenly spaced
ROWS, VALUES = 64, 128  # Rows of each, for their order, and about so many values, for their kinds
STEP_DEG = 5.0  # Largest difference in azimuth between points that a scanner measured in turn
IN_TURN = 0.6
"""Least share of such points; real scans have 0.8 or more, wrong widths 0.34 or less."""
SHARE_OF_LARGEST = 0.6
"""Least share of the largest variance; the right number of columns has 0.97 or more."""
MIN_EXPLAINED, MIN_EXPLAINED_BY_CHANCE = 0.05, 40
"""Explained variance below which nothing is said; the second is by the number of values."""
MIN_VARIANCE = 0.005  # Variance of a property below which it is not looked at
UNIT_TOLERANCE = 0.01  # Error in length of a normal
SAME_BEAM_RAD = 5e-4  # Angle between returns of one beam; adjacent beams are 1.5 mrad apart or more
MOVED_TOLERANCE_M = 0.005  # Error of a copy in another frame
MOST_ROWS = 0.9  # Share of rows that shows what the columns of all are
RANGE_LOG10 = 3.0  # Magnitudes count up to a factor of a thousand


def evident_count(values: Float, expected: int) -> int | None:
    """Return another number of columns than expected that values (M,) evidently have, else None."""
    if len(values) < 2 * max(expected, *COUNTS):
        return None
    count = expected
    if not _are_in_turn(values, expected):
        explained = {n: _explained(values, n) for n in {*COUNTS, expected}}
        most = max(explained.values())
        if most < MIN_EXPLAINED + MIN_EXPLAINED_BY_CHANCE / min(len(values), SAMPLE):
            return None
        if explained[expected] < SHARE_OF_LARGEST * most:
            # Of beams in turn, explained variance grows with the number of rows taken for one.
            in_turn = (n for n in COUNTS if _are_in_turn(values, n))
            least = min(n for n in COUNTS if explained[n] >= SHARE_OF_LARGEST * most)
            count = next(in_turn, least)
    count = _padded_count(values, count) or _least_count(values, count)
    return None if count == expected else count


def _rows(values: Float, columns: int, length: int = ROWS) -> Double:
    """Return evenly spaced blocks of rows of so many values, (BLOCKS, length, columns), or all."""
    rows = values[: len(values) // columns * columns].reshape(-1, columns)[None]
    if rows.shape[1] > BLOCKS * length:
        starts = np.linspace(0, rows.shape[1] - length, BLOCKS).astype(np.intp)
        rows = rows[0, starts[:, None] + np.arange(length)]
    with np.errstate(invalid="ignore"):  # of a signalling NaN
        return rows.astype(np.float64)


def _are_in_turn(values: Float, columns: int) -> bool:
    """Say whether rows of so many values are points measured in the order of a scanner's turn."""
    x, y = np.moveaxis(_rows(values, columns), -1, 0)[:2]
    azimuth = np.degrees(np.arctan2(y, x))
    measured = np.isfinite(azimuth) & ((x != 0) | (y != 0))
    # What follows from one block to the next is little.
    steps = np.abs((np.diff(azimuth[measured]) + 180) % 360 - 180)
    return int((steps < STEP_DEG).sum()) > IN_TURN * max(1, int(steps.size))


def _least_count(values: Float, count: int) -> int:
    """Return the number of columns of one point, of which a number may be a multiple."""
    for least in (n for n in COUNTS if n < count and count % n == 0):
        points = _rows(values, count).reshape(-1, count // least, least)
        measured = points[..., :2].any(axis=2).mean(axis=0)
        in_turn = measured.min() > measured.max() / 2 and _are_in_turn(values, least)
        alike = in_turn or _explained(values, least) > SHARE_OF_LARGEST * _explained(values, count)
        if alike and _are_of_two_points(*points[:, :2, :3].swapaxes(0, 1)):
            return least
    return count


def _are_of_two_points(first: Double, second: Double) -> bool:
    """Say whether values (N, 3) and those that follow them in each row are two points of a scan.

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
    moved = known @ np.linalg.lstsq(known, second)[0]
    is_moved = (np.abs(second - moved) < MOVED_TOLERANCE_M).all(axis=1)
    most = MOST_ROWS * len(second)
    return all(each.sum() < most for each in (is_normal, is_same_beam, is_moved))


def _padded_count(values: Float, columns: int) -> int | None:
    """Return the number of columns of a table that has only zeros beside the columns expected."""
    for count in reversed(range(2 * columns, COUNTS.stop, columns)):
        sample = _rows(values, count)
        if not sample[..., columns:].any() and sample.any():
            return count
    return None


def _explained(values: Float, columns: int) -> float:
    """Return the share of the variance of what values are like that lies between columns."""
    sample = _rows(values, columns, VALUES // columns).reshape(-1, columns)
    size = np.where(np.isfinite(sample), np.abs(sample), 1.0)
    is_whole = (size > 0) & (sample == np.rint(sample))
    magnitude = np.log10(np.maximum(size, 10**-RANGE_LOG10)) / RANGE_LOG10
    properties = np.stack([sample < 0, is_whole, np.minimum(magnitude, 1)])
    within, total = properties.var(axis=1, ddof=1).mean(axis=1), properties.var(axis=(1, 2))
    vary = total > MIN_VARIANCE
    return float(np.mean(1 - within[vary] / total[vary])) if vary.any() else 0.0
