# SPDX-License-Identifier: MIT
"""PointCloud2 messages of any layout."""

import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from salsanext_cli.errors import FormatError
from salsanext_cli.formats.bags import columns_of

PATH = Path("drive.bag/points/1")
FORMATS = dict(zip(range(1, 9), "bBhHiIfd", strict=True))


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize(
    ("height", "width", "padding"), [(1, 5, 0), (3, 2, 9), (0, 4, 0), (2, 0, 3)]
)
def test_fields_of_every_type_in_padded_points_and_rows(order, height, width, padding):
    # A byte lies before each field.
    point = struct.Struct(order + "".join(f"x{kind}" for kind in FORMATS.values()))
    places = [struct.calcsize(point.format[: 3 + 2 * n]) for n in range(len(FORMATS))]
    fields = [
        SimpleNamespace(name=kind, offset=place - struct.calcsize(kind), datatype=number, count=1)
        for (number, kind), place in zip(FORMATS.items(), places, strict=True)
    ]
    values = np.arange(height * width * len(FORMATS)).reshape(height, width, len(FORMATS))
    rows = [
        b"".join(point.pack(*values) for values in row) + bytes(padding) for row in values.tolist()
    ]
    columns = columns_of(
        message(
            fields=fields[::-1],
            height=height,
            width=width,
            point_step=point.size,
            row_step=width * point.size + padding,
            is_bigendian=order == ">",
            data=np.frombuffer(b"".join(rows), np.uint8),
        ),
        PATH,
    )
    for n, kind in enumerate(FORMATS.values()):
        np.testing.assert_array_equal(columns[kind], values[..., n].ravel())
    if height > 1 and width:
        np.testing.assert_array_equal(columns["ring"], np.repeat(range(height), width))


def message(**changed):
    fields = [
        SimpleNamespace(name=name, offset=4 * n, datatype=7, count=1)
        for n, name in enumerate("xyz")
    ]
    values = {"fields": fields, "height": 1, "width": 2, "point_step": 12, "row_step": 24}
    values |= {"is_bigendian": False, "data": np.zeros(24, np.uint8)}
    return SimpleNamespace(**{**values, **changed})


def test_a_field_of_several_values_and_a_second_one_of_a_name_are_passed_over():
    several = SimpleNamespace(name="normal", offset=0, datatype=7, count=3)
    old = SimpleNamespace(name="i", offset=0, datatype=2, count=0)
    second = SimpleNamespace(name="i", offset=4, datatype=7, count=1)
    columns = columns_of(message(row_step=0, fields=[several, old, second]), PATH)
    assert {name: values.dtype for name, values in columns.items()} == {"i": np.uint8}


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
        {"data": np.zeros(0, np.uint8)},
        {"fields": [SimpleNamespace(name="x", offset=10, datatype=7, count=1)]},
        {"fields": [SimpleNamespace(name="x", offset=0, datatype=9, count=1)]},
    ],
)
def test_sizes_that_contradict_each_other_are_refused(changed):
    with pytest.raises(FormatError, match="damaged"):
        columns_of(message(**changed), PATH)
