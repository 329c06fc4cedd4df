# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from salsanext_cli.core.records import FieldSplit
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.split_fields import split_field

N = 6000
TWO, TEN = np.arange(N) % 2, np.arange(N) % 10
MANY = np.arange(N) * 1e-5


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({}, None),
        ({"ring": TWO, "laser": TWO, "laser_id": TWO}, None),
        ({"lidar_id": TWO}, FieldSplit(field="lidar_id", kind="sensor", count=2)),
        (
            {"timestamp": MANY, "scalar_Sensor": TWO},
            FieldSplit(field="scalar_Sensor", kind="sensor", count=2),
        ),
        (
            {"lidar_id": 0 * TWO, "sweep_idx": TEN},
            FieldSplit(field="sweep_idx", kind="scan", count=10),
        ),
        ({"sensor": np.arange(N)}, None),
        ({"time_lag": 0.05 * TEN}, FieldSplit(field="time_lag", kind="scan", count=10)),
        ({"timestamp": 0 * MANY}, None),
        ({"t": np.full(N, np.nan)}, None),
    ],
)
def test_fields_that_divide_a_cloud(columns, expected):
    assert split_field(columns) == expected


def test_times_of_points_divide_a_cloud():
    split = split_field({"x": MANY, "timestamp": MANY})
    assert (split.field, split.kind) == ("timestamp", "time")


def test_the_field_of_a_file_is_read(tmp_path):
    rng = np.random.default_rng(0)
    rows = np.column_stack([rng.normal(0, 9, (500, 3)), rng.random(500), np.arange(500) % 2])
    header = "FIELDS x y z intensity lidar_id\nSIZE 4 4 4 4 4\nTYPE F F F F F\n"
    path = tmp_path / "two.pcd"
    path.write_bytes(
        f"VERSION 0.7\n{header}WIDTH 500\nHEIGHT 1\nPOINTS 500\nDATA binary\n".encode()
        + rows.astype("<f4").tobytes()
    )
    assert read_scan(path).notes.split == FieldSplit(field="lidar_id", kind="sensor", count=2)
