# SPDX-License-Identifier: MIT
"""A sensor by a name and changes of single fields, or none if nothing is requested."""

from dataclasses import replace

import pytest
from scans import SMALL, refused

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.sensors.sensor import MAX_PIXELS, OF_DEVICE, presets
from salsanext_cli.runs.sensor_request import MIN_WIDTH, requested_sensor, with_width

TRAINED = replace(SMALL, intensity_quantiles=(), row_gaps=None)
CHANGES = (
    ({"width": 128}, {"width": 128}),
    ({"min_range": 1.5}, {"min_range": 1.5}),
    ({"ego": "none"}, {"ego_box": ()}),
    ({"ego": "-1,-1,-2,1,1,0"}, {"ego_box": (-1.0, -1.0, -2.0, 1.0, 1.0, 0.0)}),
    ({"columns": "X, y,z,intensity"}, {"columns": ("x", "y", "z", "intensity")}),
    ({"intensity_field": "reflectivity"}, {"intensity_field": "reflectivity"}),
)
WRONG = (
    ("width", {"width": MIN_WIDTH - 1}),
    ("width", {"width": MAX_PIXELS // SMALL.height + 1}),
    ("ego", {"ego": "1,2,3"}),
    ("ego", {"ego": "wide"}),
    ("ego", {"ego": "1,-1,-2,-1,1,0"}),
    ("columns", {"columns": "x,y"}),
    ("intensity_field", {"intensity_field": ""}),
)


def no_sensor():
    pytest.fail("the sensor of the weights is read")


def test_nothing_that_is_requested_reads_nothing():
    assert requested_sensor("auto", no_sensor) is None


@pytest.mark.parametrize(("request_", "expected"), CHANGES)
def test_a_change_leaves_all_other_fields(request_, expected):
    sensor = requested_sensor("auto", lambda: SMALL, **request_)
    if "width" in expected:
        assert sensor == TRAINED.resized(width=128)
    else:
        assert sensor == replace(TRAINED, **expected)


@pytest.mark.parametrize("name", presets())
def test_a_built_in_sensor_has_the_images_of_the_weights(name):
    sensor = requested_sensor(name, lambda: SMALL)
    of_device = {key: getattr(presets()[name], key) for key in OF_DEVICE}
    assert sensor == replace(TRAINED, **of_device)


@pytest.mark.parametrize(("subject", "request_"), WRONG)
def test_impossible_requests_are_refused(subject, request_):
    refused(UsageError, subject, requested_sensor, "auto", lambda: SMALL, **request_)


@pytest.mark.parametrize("width", [MIN_WIDTH, MAX_PIXELS // SMALL.height])
def test_the_narrowest_and_the_widest_images_are_possible(width):
    assert with_width(SMALL, width).width == width
