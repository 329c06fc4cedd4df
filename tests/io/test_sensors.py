# SPDX-License-Identifier: MIT
"""Sensors by name or file."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from valid_sensor import VALID

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.sensors import sensor


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
