# SPDX-License-Identifier: MIT
"""Metadata of an ONNX file, read without its graph in bounded time and memory."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from salsanext_cli.errors import FormatError, WeightsError
from salsanext_cli.files.reading import present, reading, size_of

OPSET = 17
"""The latest that TensorRT 8.6 reads; OpenVINO and ONNX Runtime read later ones too."""
MAX_BYTES = 2 << 30
"""Largest message of protobuf."""
MAX_FIELDS = 1000
"""Most fields of a message; an exporter writes a dozen."""
MAX_ENTRY_BYTES = 1 << 24
VARINT, BYTES = 0, 2
"""Kinds of values that are read."""
GRAPH, OPSET_IMPORT, METADATA = 7, 8, 14
"""Numbers of fields of ModelProto in ONNX's onnx.proto."""
KEY, VALUE = 1, 2
"""Numbers of the fields of an entry of METADATA; of OPSET_IMPORT, domain and version."""


def onnx_metadata(path: Path) -> dict[str, str]:
    """Return the metadata of an ONNX file."""
    remedy = "write it with `salsanext export-onnx`"
    try:
        with reading(path) as file:
            if (size := size_of(file)) > MAX_BYTES:
                raise ValueError(f"{size} bytes")
            opsets, metadata = _model(file, size)
    except FormatError as error:
        found = error.found if present(path) else "no such file"
        raise WeightsError(path, found, "an ONNX file") from error
    except ValueError as error:
        raise WeightsError(path, f"no ONNX file, or a cut one: {error}", "one", remedy) from error
    if (opset := opsets.get("", 1)) != OPSET:
        raise WeightsError(path, f"opset {opset}", str(OPSET), remedy)
    return metadata


def _model(file: BinaryIO, size: int) -> tuple[dict[str, int], dict[str, str]]:
    """Read the versions of the operators by domain, and the metadata."""
    opsets, metadata, has_graph = {}, {}, False
    for number, _, length in _fields(file, size):
        has_graph |= number == GRAPH
        if number not in (OPSET_IMPORT, METADATA):
            file.seek(length, 1)
            continue
        if length > MAX_ENTRY_BYTES:
            raise ValueError(f"an entry of {length} bytes")
        texts, numbers = _entry(file.read(length))
        if number == METADATA:
            metadata[texts.get(KEY, "")] = texts.get(VALUE, "")
        else:
            opsets[texts.get(KEY, "")] = numbers.get(VALUE, 0)
    if not has_graph:
        raise ValueError("it has no graph")
    return opsets, metadata


def _entry(content: bytes) -> tuple[dict[int, str], dict[int, int]]:
    """Read the texts and the numbers of a message by the numbers of their fields."""
    file, texts, numbers = io.BytesIO(content), {}, {}
    for number, value, length in _fields(file, len(content)):
        if length:
            texts[number] = file.read(length).decode()
        else:
            numbers[number] = value
    return texts, numbers


def _fields(file: BinaryIO, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield each field's number, value if it is a number, and length of what is to be read."""
    for _ in range(MAX_FIELDS):
        if file.tell() == end:
            return
        number, kind = divmod(_varint(file), 8)
        if kind not in (VARINT, BYTES):
            raise ValueError(f"a field of kind {kind}")
        value = _varint(file)
        if kind == BYTES and file.tell() + value > end:
            raise ValueError(f"a field of {value} bytes goes beyond the end")
        yield (number, 0, value) if kind == BYTES else (number, value, 0)
    raise ValueError(f"more than {MAX_FIELDS} fields")


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
