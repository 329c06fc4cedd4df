# SPDX-License-Identifier: MIT
"""Messages of point clouds."""

import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.formats.ros.cloud_messages import columns_of_fields

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
    columns = columns_of_fields(
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


def message(**changed):
    fields = [
        SimpleNamespace(name=name, offset=4 * n, datatype=7, count=1)
        for n, name in enumerate("xyz")
    ]
    values = {"fields": fields, "height": 1, "width": 2, "point_step": 12, "row_step": 24}
    values |= {"is_bigendian": False, "data": np.zeros(24, np.uint8)}
    return SimpleNamespace(**{**values, **changed})


def test_fields_of_several_values_and_repeated_names_are_skipped():
    several = SimpleNamespace(name="normal", offset=0, datatype=7, count=3)
    old = SimpleNamespace(name="i", offset=0, datatype=2, count=0)
    second = SimpleNamespace(name="i", offset=4, datatype=7, count=1)
    columns = columns_of_fields(message(row_step=0, fields=[several, old, second]), PATH)
    assert {name: values.dtype for name, values in columns.items()} == {"i": np.uint8}


@pytest.mark.parametrize("row_step", [0, 12, 3 * 2 * 12])
def test_clouds_without_padding_are_read_whatever_the_row_step(row_step):
    """As drivers of ZED cameras write it: the size of the whole cloud."""
    values = np.arange(18, dtype="<f4").reshape(3, 2, 3)
    data = np.frombuffer(values.tobytes(), np.uint8)
    columns = columns_of_fields(message(height=3, row_step=row_step, data=data), PATH)
    for n, name in enumerate("xyz"):
        np.testing.assert_array_equal(columns[name], values[..., n].ravel())


def test_sizes_that_contradict_each_other_are_refused():
    for changed in (
        {"width": 10**12},
        {"height": 10**6, "width": 10**6, "row_step": 12 * 10**6},
        {"height": 2, "row_step": 48},
        {"height": 2},
        {"height": 2, "row_step": 3},
        {"point_step": 10**12},
        {"point_step": 11},
        {"data": np.zeros(23, np.uint8)},
        {"data": np.zeros(0, np.uint8)},
        {"fields": [SimpleNamespace(name="x", offset=10, datatype=7, count=1)]},
        {"fields": [SimpleNamespace(name="x", offset=0, datatype=9, count=1)]},
    ):
        with pytest.raises(FormatError, match="damaged"):
            columns_of_fields(message(**changed), PATH)
