# SPDX-License-Identifier: MIT
"""Stated sizes of compressed points."""

import struct

import numpy as np
import pytest
from las_files import write_las

from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.formats.survey.las_file import read_las_file

laspy = pytest.importorskip("laspy")
pytest.importorskip("lazrs")
POINTS = np.random.default_rng(0).uniform(-50, 50, (50_100, 3))
"""Points of two chunks."""
OFFSET_BYTES = 8  # Offset of the table of chunks, before the first chunk
POINT_COUNT_BYTES = 4
VERSION_BYTES = 4  # Before the number of chunks in their table


@pytest.mark.parametrize("extra", [{}, {"reflectance": np.arange(len(POINTS), dtype=np.float32)}])
@pytest.mark.parametrize("kind", [0, 3, 6, 7, 8])
def test_points_of_several_chunks_are_those_that_laspy_reads(tmp_path, kind, extra):
    path = write_las(tmp_path / "s.laz", POINTS, kind=kind, extra=extra)
    file = read_las_file(path)
    expected = laspy.read(path)
    assert np.array_equal(file.points.array, expected.points.array)


def with_layer_bytes(path, layer_bytes):
    """State other bytes of the first layer of the first chunk."""
    content = bytearray(path.read_bytes())
    with laspy.open(path) as reader:
        first_chunk = reader.header.offset_to_point_data + OFFSET_BYTES
        sizes = first_chunk + reader.header.point_format.size + POINT_COUNT_BYTES
    (before,) = struct.unpack_from("<I", content, sizes)
    struct.pack_into("<I", content, sizes, layer_bytes)
    path.write_bytes(content)
    return before


def test_a_layer_above_the_size_of_its_chunk_is_refused(tmp_path):
    """Lazrs would allocate and fill four gigabytes for it."""
    path = write_las(tmp_path / "s.laz", POINTS[:100], kind=6)
    right = with_layer_bytes(path, 0xFFFFFFFF)
    with pytest.raises(FormatError, match="more bytes than it contains"):
        read_las_file(path)
    with_layer_bytes(path, right)
    assert len(read_las_file(path).points) == 100


def test_a_table_without_chunks_is_refused(tmp_path):
    path = write_las(tmp_path / "s.laz", POINTS[:100], kind=6)
    content = bytearray(path.read_bytes())
    with laspy.open(path) as reader:
        points = reader.header.offset_to_point_data
    (table,) = struct.unpack_from("<q", content, points)
    struct.pack_into("<I", content, table + VERSION_BYTES, 0)
    path.write_bytes(content)
    with pytest.raises(FormatError, match="fewer points"):
        read_las_file(path)
