# SPDX-License-Identifier: MIT
"""Metadata of an ONNX file, read without its graph."""

from collections.abc import Iterator
from pathlib import Path

from salsanext_cli.errors import FormatError, WeightsError
from salsanext_cli.files.reading import present, reading

OPSET = 17  # The latest that TensorRT 8.6 reads; OpenVINO and ONNX Runtime read later ones too
MAX_FIELDS = 1000  # Most fields of a message; an exporter writes a dozen
VARINT, BYTES = 0, 2  # Kinds of values that are read
GRAPH, OPSET_IMPORT, METADATA = 7, 8, 14  # Numbers of fields of ModelProto in ONNX's onnx.proto
KEY, VALUE = 1, 2
"""Numbers of the fields of an entry of METADATA; of OPSET_IMPORT, domain and version."""


def onnx_metadata(path: Path) -> dict[str, str]:
    """Return the metadata of an ONNX file."""
    remedy = "write it with `salsanext export-onnx`"
    try:
        with reading(path) as file:
            model = [*_fields(file.read())]
        if all(number != GRAPH for number, _, _ in model):
            raise ValueError("it has no graph")
        versions = [_entry(content) for number, _, content in model if number == OPSET_IMPORT]
        metadata = [_entry(content) for number, _, content in model if number == METADATA]
    except FormatError as error:
        found = error.found if present(path) else "no such file"
        raise WeightsError(path, found, "an ONNX file") from error
    except ValueError as error:
        raise WeightsError(path, f"no ONNX file, or a cut one: {error}", "one", remedy) from error
    opset = next((version for domain, _, version in versions if domain == ""), 1)
    if opset != OPSET:
        raise WeightsError(path, f"opset {opset}", str(OPSET), remedy)
    return {key: text for key, text, _ in metadata}


def _entry(content: bytes) -> tuple[str, str, int]:
    """Return the text of `KEY` and, of `VALUE`, the text or the number."""
    key, text, count = "", "", 0
    for number, value, part in _fields(content):
        if number == KEY:
            key = part.decode()
        elif number == VALUE:
            text, count = part.decode(), value
    return key, text, count


def _fields(content: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield number, value and content of the fields of a message, one of which a field has."""
    at = 0
    for _ in range(MAX_FIELDS):
        if at == len(content):
            return
        key, at = _varint(content, at)
        value, at = _varint(content, at)
        number, kind = divmod(key, 8)
        if kind == VARINT:
            yield number, value, b""
        elif kind != BYTES:
            raise ValueError(f"a field of kind {kind}")
        elif at + value > len(content):
            raise ValueError(f"a field of {value} bytes goes beyond the end")
        else:
            yield number, 0, content[at : at + value]
            at += value
    raise ValueError(f"more than {MAX_FIELDS} fields")


def _varint(content: bytes, at: int) -> tuple[int, int]:
    """Read a number of seven bits per byte, the lowest first; also return the place after it."""
    value = 0
    for shift, byte in enumerate(content[at : at + 10]):
        value |= (byte & 127) << (7 * shift)
        if byte < 128:
            return value, at + shift + 1
    raise ValueError("a number that does not end, or of more than ten bytes")
