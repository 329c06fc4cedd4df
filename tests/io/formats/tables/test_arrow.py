# SPDX-License-Identifier: MIT
"""Feather and Parquet files."""

import io

import numpy as np
import pytest
from scans import make_scan

from salsanext_cli import read_scan
from salsanext_cli.core.errors import FormatError, LabelError
from salsanext_cli.core.notices import NOTICE, log_once
from salsanext_cli.io.formats.tables.arrow import feather_columns, feather_subset

arrow = pytest.importorskip("pyarrow")

SCAN = make_scan(300)
TABLE = np.column_stack([SCAN.points, SCAN.intensity])
X, Y, Z, I = TABLE.T  # noqa: E741 - the name of the column


@pytest.fixture
def said(caplog):
    """Return the log of a process that has not read any file."""
    log_once.cache_clear()
    caplog.set_level(NOTICE, "salsanext_cli")
    return caplog


def feather(table):
    """Return the content of a Feather file."""
    file = io.BytesIO()
    table = table if isinstance(table, arrow.Table) else arrow.table(table)
    pytest.importorskip("pyarrow.feather").write_feather(table, file)
    return file.getvalue()


@pytest.mark.parametrize("compression", ["none", "snappy", "zstd"])
def test_parquet_is_read_as_feather(tmp_path, compression):
    write = pytest.importorskip("pyarrow.parquet").write_table
    path = tmp_path / "s.parquet"
    notes = ["ground"] * 300
    columns = dict(zip(("x", "y", "z", "intensity"), TABLE.T, strict=True))
    z = arrow.array(Z, mask=np.arange(300) == 7)
    write(arrow.table({**columns, "z": z, "notes": notes}), path, compression=compression)
    scan, expected = read_scan(path), SCAN.points.copy()
    # An empty cell is a point without a measurement.
    expected[7, 2] = np.nan
    np.testing.assert_array_equal(scan.points, expected)
    np.testing.assert_array_equal(scan.intensity, SCAN.intensity)
    write(arrow.table({"x": X, "y": Y}), path)
    with pytest.raises(FormatError, match="also z"):
        read_scan(path)
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(FormatError, match="damaged or cut off"):
        read_scan(path)


def test_scans_of_argoverse(tmp_path, said):
    """Coordinates have 16 bits, intensities a byte."""
    path = tmp_path / "315969904359876000.feather"
    table = {axis: values.astype("<f2") for axis, values in zip("xyz", TABLE.T, strict=False)}
    intensity = np.arange(300).astype(np.uint8)
    times = np.arange(300, dtype="i4")
    path.write_bytes(feather(table | {"intensity": intensity, "offset_ns": times}))
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points, SCAN.points.astype("<f2").astype("<f4"))
    np.testing.assert_array_equal(scan.intensity, intensity.astype("<f4") / np.float32(255))
    assert "16 bits" in said.text
    for content, problem in (
        (path.read_bytes()[:-9], "damaged or cut off"),
        (b"FEA1" + bytes(99), "Feather version 1"),
    ):
        path.write_bytes(content)
        with pytest.raises(FormatError, match=problem):
            read_scan(path)


def test_a_subset_has_the_rows_of_its_mask_and_the_metadata(tmp_path):
    path = tmp_path / "s.feather"
    notes = [f"n{i}" for i in range(300)]
    table = arrow.table({"x": X, "notes": notes}).replace_schema_metadata({"site": "Ulm"})
    path.write_bytes(feather(table))
    mask = np.arange(300) % 7 == 3
    subset = feather_subset(path)
    path.write_bytes(subset(mask))
    columns = feather_columns(path)
    np.testing.assert_array_equal(columns["x"], X[mask])
    assert columns["notes"].tolist() == [f"n{i}" for i in np.flatnonzero(mask)]
    assert arrow.feather.read_table(path).schema.metadata == {b"site": b"Ulm"}
    with pytest.raises(LabelError):
        subset(mask[1:])
