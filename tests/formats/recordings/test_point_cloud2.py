# SPDX-License-Identifier: MIT
"""PointCloud2 messages of any layout, against a reader of one value at a time."""

import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.errors import FormatError
from salsanext_cli.formats.bags import TYPES, columns_of

PATH = Path("drive.bag/points/1")
FORMATS = dict(zip(range(1, 9), "bBhHiIfd", strict=True))


def slow_columns(message):
    """Read the fields value by value, as the definition of the message says."""
    order = ">" if message.is_bigendian else "<"
    found = {}
    for field in message.fields:
        values = [
            struct.unpack_from(
                order + FORMATS[field.datatype],
                message.data,
                row * message.row_step + column * message.point_step + field.offset,
            )[0]
            for row in range(message.height)
            for column in range(message.width)
        ]
        found.setdefault(field.name, values)
    return found


@st.composite
def clouds(draw):
    """Make messages with fields in any order, gaps, padded rows and any bytes."""
    names = draw(st.lists(st.sampled_from(["x", "y", "z", "i", "ring", "t"]), max_size=7))
    fields, end = [], 0
    for name in names:
        kind = draw(st.integers(1, 8))
        offset = end + draw(st.integers(0, 5))
        end = offset + np.dtype(TYPES[kind]).itemsize
        fields.append(SimpleNamespace(name=name, offset=offset, datatype=kind, count=1))
    step = end + draw(st.integers(0, 5))
    height, width = draw(st.integers(0, 4)), draw(st.integers(0, 5))
    row = width * step + (draw(st.integers(0, 9)) if height > 1 else 0)
    data = draw(st.binary(min_size=height * row, max_size=height * row))
    return SimpleNamespace(
        fields=draw(st.permutations(fields)),
        height=height,
        width=width,
        point_step=step,
        row_step=row,
        is_bigendian=draw(st.booleans()),
        data=np.frombuffer(data, np.uint8),
    )


@given(clouds())
def test_any_layout_is_read_as_value_by_value(message):
    expected = slow_columns(message)
    if message.height > 1 and message.width > 0 and expected:
        rows = [row for row in range(message.height) for _ in range(message.width)]
        expected = {"ring": rows} | expected
    columns = columns_of(message, PATH)
    assert columns.keys() == expected.keys()
    for name, values in columns.items():
        np.testing.assert_array_equal(values, np.array(expected[name], values.dtype))


def message(**changed):
    fields = [
        SimpleNamespace(name=name, offset=4 * n, datatype=7, count=1)
        for n, name in enumerate("xyz")
    ]
    values = {"fields": fields, "height": 1, "width": 2, "point_step": 12, "row_step": 24}
    values |= {"is_bigendian": False, "data": np.zeros(24, np.uint8)}
    return SimpleNamespace(**{**values, **changed})


def test_a_single_row_may_have_any_length_and_a_field_of_several_values_is_passed_over():
    several = SimpleNamespace(name="normal", offset=0, datatype=7, count=3)
    old = SimpleNamespace(name="i", offset=0, datatype=2, count=0)
    columns = columns_of(message(row_step=0, fields=[several, old]), PATH)
    assert [*columns] == ["i"]


@pytest.mark.parametrize(
    "changed",
    [
        {"width": 10**12},
        {"height": 10**6, "width": 10**6, "row_step": 12 * 10**6},
        {"height": 2},
        {"height": 2, "row_step": 3},
        {"point_step": 10**12},
        {"point_step": 11},
        {"data": np.zeros(23, np.uint8)},
        {"fields": [SimpleNamespace(name="x", offset=10, datatype=7, count=1)]},
        {"fields": [SimpleNamespace(name="x", offset=0, datatype=9, count=1)]},
    ],
)
def test_sizes_that_contradict_each_other_are_refused(changed):
    with pytest.raises(FormatError, match="damaged"):
        columns_of(message(**changed), PATH)
