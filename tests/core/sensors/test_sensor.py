# SPDX-License-Identifier: MIT
import json
import math
from dataclasses import replace

import pytest
from scans import refused
from valid_sensor import VALID

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.sensors.sensor import Sensor, SensorNoise, presets
from salsanext_cli.io.sensors import sensor


@pytest.mark.parametrize("name", presets())
def test_presets_have_a_name_and_noise_and_survive_json(name: str) -> None:
    preset = sensor(name)
    assert preset.name == name
    assert None not in (preset.range_noise, preset.intensity_noise)
    assert Sensor.from_dict(json.loads(json.dumps(preset.to_dict()))) == preset


def test_impossible_sensors_and_excessive_sizes_are_refused():
    for change in (
        {"fov_up": -25},
        {"fov_up": math.nan},
        {"fov_down": -math.inf},
        {"height": 0},
        {"means": (0, 0, 0, 0)},
        {"stds": (1, 1, 1, 1)},
        {"out_of_view": "wrap"},
        {"intensity_scale": 1e-40},
        {"stds": (1, 1, 1, 1, 1e-40)},
        {"means": (math.nan, 0, 0, 0, 0)},
        {"range_noise": -0.01},
        {"intensity_noise": math.inf},
        # Values of another type
        {"fov_up": "3"},
        {"height": 64.5},
        {"means": 1.0},
        {"means": ["a", "b", "c", "d", "e"]},
        {"intensity_scale": "255"},
        {"columns": "xyz"},
        {"columns": ["x", "y"]},
        {"columns": ["x", "y", "z", "x"]},
        {"columns": ["x", "y", "z", "Ring"]},
        {"columns": ["x", "y", "z", ""]},
        {"columns": ["x", "y", "z", 3]},
        {"columns": ["x", "y", "z", *"_" * 62]},
        {"intensity_field": 3},
        {"intensity_field": "x"},
        {"intensity_field": " i"},
        {"row_gaps": 1.5},
        {"origin": (0, 1e9, 0)},
        {"intensity_quantiles": (0.0, 1.0)},
        {"intensity_quantiles": (1.0,) + (0.0,) * 64},
    ):
        with pytest.raises(UsageError, match="sensor"):
            Sensor.from_dict(VALID.to_dict() | change)
    assert VALID.resized() == VALID
    assert VALID.resized(height=32) == replace(VALID, height=32)
    assert VALID.resized(width=32768) == replace(VALID, width=32768)
    with pytest.raises(UsageError, match=r"4096×4096 pixels .*expected at most 2097152"):
        VALID.resized(4096, 4096)
    with pytest.raises(UsageError, match=r"a number of \d+ bits"):
        VALID.resized(1 << 2000, 1 << 2000)


@pytest.mark.parametrize("missing", ["range_noise", "intensity_noise"])
def test_noise_that_a_sensor_does_not_state_is_refused(missing):
    noisy = replace(VALID, name="noisy", range_noise=0.03, intensity_noise=0.1)
    assert noisy.require_noise() == SensorNoise(range=0.03, intensity=0.1)
    refused(UsageError, "sensor noisy", replace(noisy, **{missing: None}).require_noise)


def test_the_view_is_all_but_name_noise_and_quantiles():
    one = sensor("hdl64")
    assert one.view() == replace(one, name="x", range_noise=None, intensity_noise=1.0).view()
    assert one.view() != replace(one, out_of_view="drop").view()
    one = replace(one, intensity_quantiles=(0.0,) * 65, row_gaps=0.2)
    others = {"name", "range_noise", "intensity_noise", "intensity_quantiles", "row_gaps"}
    assert set(one.to_dict()) - set(one.view()) == others
