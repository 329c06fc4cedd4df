# SPDX-License-Identifier: MIT
"""Points in the frames of their sensors, compared with those of single scans."""

import numpy as np
from devices import on_each_device

from salsanext_cli.core.geometry.sensor_frame import ego_points, in_sensor_frame, without_ego
from salsanext_cli.core.on_device.frames import sensor_points


@on_each_device
def test_points_and_counts_are_those_of_single_scans(batch_of, scans, sensors):
    batch = batch_of(scans, sensors)
    found = sensor_points(batch)
    pairs = list(zip(scans, sensors, strict=True))
    expected = np.concatenate([without_ego(*pair).points for pair in pairs])
    np.testing.assert_array_equal(found.points.cpu().numpy(), expected)
    counts = [len(ego_points(in_sensor_frame(*pair).points, pair[1])) for pair in pairs]
    assert batch.sum_per_scan(found.is_ego).tolist() == counts
    assert min(counts[-2:]) > 0


@on_each_device
def test_points_of_an_upright_sensor_at_the_origin_stay(batch_of, scans, sensors):
    batch = batch_of(scans, sensors[:1] * len(scans))
    found = sensor_points(batch)
    assert found.points is batch.points
    assert found.is_ego is None
