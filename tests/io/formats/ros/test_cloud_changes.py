# SPDX-License-Identifier: MIT
"""Clouds with fewer points or further values, compared with the columns of the old ones."""

from pathlib import Path

import numpy as np
import pytest
from scans import refused

pytest.importorskip("rosbags")

from bags import LIVOX, channels, cloud, livox, structured
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from salsanext_cli.core.errors import FormatError, LabelError
from salsanext_cli.io.formats.ros.cloud_changes import cloud_subset, cloud_with_values
from salsanext_cli.io.formats.ros.cloud_messages import CLOUD_MESSAGES

PATH = Path("drive.bag/points/1")
POINTS = structured(30)
POINTS["intensity"] = np.arange(30)
BIG = POINTS.astype([(name, ">f4") for name in POINTS.dtype.names])
MASK = np.arange(30) % 3 == 0
CLOUDS = {
    "row": cloud(POINTS),
    "organised": cloud(POINTS, height=5, row_padding=7),
    "row step of the whole cloud": cloud(POINTS, height=5, row_step=30 * 32),
    "big endian": cloud(BIG),
    "livox": livox(POINTS),
    "channels": channels(POINTS),
}
VALUES = {
    "label": np.arange(30, dtype=np.uint32),
    "instance": np.arange(30, dtype=np.uint16)[::-1].copy(),
    "error": np.linspace(0, 1, 30, dtype=np.float32),
}


def types(store=Stores.ROS2_JAZZY):
    known = get_typestore(store)
    for name, definition in LIVOX.items():
        known.register(get_types_from_msg(definition, f"livox_ros_driver2/msg/{name}"))
    return known.types


def columns(message):
    return CLOUD_MESSAGES[message.__msgtype__](message, PATH)


@pytest.mark.parametrize("name", CLOUDS)
@pytest.mark.parametrize("mask", [MASK, ~MASK, MASK | True, MASK & False])
def test_a_subset_has_the_columns_of_the_remaining_points(name, mask):
    message = CLOUDS[name](types())
    new = cloud_subset(message, mask, PATH)
    assert new.header == message.header
    expected = {key: values[mask] for key, values in columns(message).items()}
    found = columns(new)
    assert found.keys() == expected.keys()
    for key, values in expected.items():
        assert found[key].dtype == values.dtype
        np.testing.assert_array_equal(found[key], values)


def test_bytes_between_the_fields_stay():
    points = structured(6)
    raw = points.view(np.uint8).reshape(6, 32)
    raw[:] = np.random.default_rng(0).integers(0, 256, raw.shape)
    message = cloud(points)(types())
    new = cloud_subset(message, np.array([0, 1, 1, 0, 0, 1], bool), PATH)
    assert new.data.tobytes() == raw[[1, 2, 5]].tobytes()
    assert (new.height, new.width, new.row_step, new.point_step) == (1, 3, 96, 32)
    assert new.fields == message.fields


@pytest.mark.parametrize("store", [Stores.ROS1_NOETIC, Stores.ROS2_JAZZY])
@pytest.mark.parametrize("name", CLOUDS)
def test_new_values_are_beside_those_of_the_cloud(name, store):
    message = CLOUDS[name](types())
    new = cloud_with_values(message, VALUES, PATH, types(store))
    assert (new.header.stamp.sec, new.header.frame_id) == (1, "lidar")
    found = columns(new)
    for key, values in {**columns(message), **VALUES}.items():
        np.testing.assert_array_equal(found[key], values)
    assert new.height == (5 if name.startswith(("organised", "row step")) else 1)
    assert new.height * new.width == 30
    assert len(new.data) == 30 * new.point_step


def test_a_new_value_takes_the_place_of_a_field_of_its_name():
    new = cloud_with_values(CLOUDS["row"](types()), {"ring": VALUES["error"]}, PATH, types())
    assert [field.name for field in new.fields].count("ring") == 1
    np.testing.assert_array_equal(columns(new)["ring"], VALUES["error"])


def test_other_numbers_and_damaged_clouds_are_refused():
    message = CLOUDS["row"](types())
    refused(LabelError, PATH, cloud_subset, message, MASK[1:], PATH)
    error = {"error": VALUES["error"][1:]}
    refused(LabelError, PATH, cloud_with_values, message, error, PATH, types())
    short = cloud(POINTS, data=np.zeros(30 * 32 - 1, np.uint8))(types())
    refused(FormatError, PATH, cloud_subset, short, MASK, PATH)
    refused(FormatError, PATH, cloud_with_values, short, VALUES, PATH, types())


def test_an_empty_cloud_stays_empty():
    message = cloud(structured(0))(types())
    assert len(cloud_subset(message, np.zeros(0, bool), PATH).data) == 0
    values = {"error": np.zeros(0, np.float32)}
    assert len(cloud_with_values(message, values, PATH, types()).data) == 0
