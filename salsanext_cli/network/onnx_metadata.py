# SPDX-License-Identifier: MIT
"""Metadata of an ONNX file, read without its graph in bounded time and memory."""

from pathlib import Path
from typing import BinaryIO

from salsanext_cli.errors import FormatError, WeightsError
from salsanext_cli.formats.reading import reading, size_of

ONNX_SUFFIX = ".onnx"
MAX_BYTES = 2 << 30
"""Largest message of protobuf."""
MAX_FIELDS = 1000
"""Most fields of a model; an exporter writes a dozen."""
MAX_METADATA_BYTES = 1 << 24
VARINT, BYTES = 0, 2
"""Kinds of values that a model has on its first level."""
GRAPH, METADATA = 7, 14
"""Numbers of fields of ModelProto in ONNX's onnx.proto."""
KEY, VALUE = 1, 2
"""Numbers of fields of StringStringEntryProto."""


def onnx_metadata(path: Path) -> dict[str, str]:
    """Return the metadata of an ONNX file.

    Raises
    ------
    WeightsError
        If it cannot be read, is no ONNX file, or is cut or damaged on its first level.
    """
    try:
        with reading(path) as file:
            return _metadata(file)
    except FormatError as error:
        found = error.found if path.exists() else "no such file"
        raise WeightsError(path, found, "an ONNX file") from error
    except ValueError as error:
        remedy = "write it with `salsanext export-onnx`"
        raise WeightsError(path, f"no ONNX file, or a cut one: {error}", "one", remedy) from error


def _metadata(file: BinaryIO) -> dict[str, str]:
    found, has_graph, size = {}, False, size_of(file)
    if size > MAX_BYTES:
        raise ValueError(f"{size} bytes")
    for _ in range(MAX_FIELDS):
        if file.tell() == size:
            break
        number, length = _field(file, size)
        has_graph |= number == GRAPH
        if number == METADATA:
            if length > MAX_METADATA_BYTES:
                raise ValueError(f"metadata of {length} bytes")
            key, value = _entry(file, file.tell() + length)
            found[key] = value
        else:
            file.seek(length, 1)
    else:
        raise ValueError(f"more than {MAX_FIELDS} fields")
    if not has_graph:
        raise ValueError("it has no graph")
    return found


def _entry(file: BinaryIO, end: int) -> tuple[str, str]:
    """Read a pair of strings."""
    texts = {KEY: "", VALUE: ""}
    while file.tell() < end:
        number, length = _field(file, end)
        texts[number] = file.read(length).decode()
    return texts[KEY], texts[VALUE]


def _field(file: BinaryIO, end: int) -> tuple[int, int]:
    """Read the head of a field; return its number and the bytes of its value that follow."""
    number, kind = divmod(_varint(file), 8)
    if kind not in (VARINT, BYTES):
        raise ValueError(f"a field of kind {kind}")
    value = _varint(file)
    length = value if kind == BYTES else 0
    if file.tell() + length > end:
        raise ValueError(f"a field of {length} bytes goes beyond the end")
    return number, length


def _varint(file: BinaryIO) -> int:
    """Read a number of seven bits per byte, the lowest first; the eighth says that more follow."""
    value = 0
    for shift in range(0, 70, 7):
        byte = file.read(1)
        if not byte:
            raise ValueError("it ends within a field")
        value |= (byte[0] & 127) << shift
        if byte[0] < 128:
            return value
    raise ValueError("a number of more than ten bytes")
