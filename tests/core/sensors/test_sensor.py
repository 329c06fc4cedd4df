# SPDX-License-Identifier: MIT
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.sensors.sensor import Sensor, presets
from salsanext_cli.io.sensors import sensor

VALID = Sensor("valid", fov_up=3, fov_down=-25, height=64, width=2048)


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


def test_file_and_its_unknown_and_missing_keys(tmp_path):
    path = tmp_path / "mein sensor.toml"
    path.write_text("fov_up = 10\nfov_down = -10.5\nheight = 16\nwidth = 900\n")
    read = sensor(path)
    assert read == Sensor("mein sensor", 10, -10.5, 16, 900)
    path.write_text(path.read_text() + 'name = "eigen"\nmeans = [1, 2, 3, 4, 5]\n')
    assert sensor(str(path)) == replace(read, name="eigen", means=(1, 2, 3, 4, 5))
    with pytest.raises(UsageError, match="fov_upp"):
        Sensor.from_dict(VALID.to_dict() | {"fov_upp": 3})
    with pytest.raises(UsageError, match="lacks fov_down, height"):
        Sensor.from_dict({"name": "s", "fov_up": 1, "width": 1})


def test_columns_and_origin_are_written_if_stated(tmp_path: Path) -> None:
    for key, value in (
        ("columns", ("x", "y", "z", "_", "ring", "_")),
        ("intensity_field", "scalar_Amplitude"),
        ("origin", (0.9, 0.0, 1.75)),
    ):
        stated = replace(VALID, **{key: value})
        assert stated.view() != VALID.view()
        assert key not in VALID.to_dict()
        assert key not in VALID.to_toml()
        (tmp_path / "valid.toml").write_text(stated.to_toml())
        assert sensor(tmp_path / "valid.toml") == stated
        assert Sensor.from_dict(json.loads(json.dumps(stated.to_dict()))) == stated


@pytest.mark.parametrize(
    "text", ["fov_up = ", "fov_up = 1", "speed = 3\n", "[hdl64]\nfov_up = 3\n", "\xff"]
)
def test_bad_files(tmp_path: Path, text: str) -> None:
    path = tmp_path / "s.toml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(UsageError, match=r"s\.toml"):
        sensor(path)


def test_neither_preset_nor_file(tmp_path: Path) -> None:
    for name, message in (
        ("hdl46", "one of hdl64"),
        (tmp_path / "s.toml", r"s\.toml: no such preset or file"),
        (tmp_path, "is a directory"),
        ("a" * 300, "file name too long"),
    ):
        with pytest.raises(UsageError, match=message):
            sensor(name)


def test_the_view_is_all_but_name_noise_and_quantiles():
    one = sensor("hdl64")
    assert one.view() == replace(one, name="x", range_noise=None, intensity_noise=1.0).view()
    assert one.view() != replace(one, out_of_view="drop").view()
    one = replace(one, intensity_quantiles=(0.0,) * 65, row_gaps=0.2)
    others = {"name", "range_noise", "intensity_noise", "intensity_quantiles", "row_gaps"}
    assert set(one.to_dict()) - set(one.view()) == others
