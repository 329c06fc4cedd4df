# SPDX-License-Identifier: MIT
"""Batches of scans have the points of the scans, one after the other."""

import numpy as np
from devices import on_each_device

from salsanext_cli import Scan


@on_each_device
def test_a_batch_has_the_points_of_its_scans_in_order(batch_of, scans, sensors):
    batch = batch_of(scans, sensors)
    expected = np.concatenate([scan.points for scan in scans])
    np.testing.assert_array_equal(batch.points.cpu().numpy(), expected)
    expected = np.concatenate([scan.intensity for scan in scans])
    np.testing.assert_array_equal(batch.intensity.cpu().numpy(), expected)
    numbers = [number for number, scan in enumerate(scans) for _ in range(len(scan))]
    assert batch.scan_of_point.tolist() == numbers
    assert batch.counts == [len(scan) for scan in scans]


@on_each_device
def test_arrays_that_cannot_be_written_are_copied(batch_of, sensors):
    table = np.arange(20, dtype=np.float32).reshape(5, 4)
    table.setflags(write=False)
    batch = batch_of([Scan(table[:, :3], table[:, 3])], sensors[:1])
    np.testing.assert_array_equal(batch.points.cpu().numpy(), table[:, :3])
