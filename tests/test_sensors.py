# SPDX-License-Identifier: MIT
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.errors import UsageError
from salsanext_cli.sensors import Sensor, presets, sensor

VALID = Sensor("valid", fov_up=3, fov_down=-25, height=64, width=2048)


def test_facts_of_the_hdl64() -> None:
    hdl64 = sensor("hdl64")
    assert (hdl64.fov_up, hdl64.fov_down, hdl64.height, hdl64.width) == (3, -25, 64, 2048)
    assert hdl64.means == (12.12, 10.88, 0.23, -1.04, 0.21)
    assert hdl64.stds == (12.32, 11.47, 6.91, 0.86, 0.16)
    assert hdl64.intensity_scale == 1
    assert hdl64.out_of_view == "clamp"


@pytest.mark.parametrize("name", presets())
def test_presets_bear_their_name_and_survive_json(name: str) -> None:
    preset = sensor(name)
    assert preset.name == name
    assert Sensor.from_dict(json.loads(json.dumps(preset.to_dict()))) == preset


@pytest.mark.parametrize(("up", "down"), [(25, 3), (-3, -25), (0, -25), (25, 0)])
def test_both_edges_may_lie_on_one_side_of_the_horizon(up: float, down: float) -> None:
    tilted = replace(VALID, fov_up=up, fov_down=down)
    assert tilted.fov_up - tilted.fov_down == up - down


@given(st.floats(-89, 89), st.floats(0.5, 90), st.integers(1, 256), st.integers(1, 4096))
def test_any_possible_sensor_survives_json(
    down: float, extent: float, height: int, width: int
) -> None:
    made = Sensor("s", down + extent, down, height, width, out_of_view="drop", intensity_scale=255)
    assert Sensor.from_dict(json.loads(json.dumps(made.to_dict()))) == made


@pytest.mark.parametrize(
    "change",
    [
        {"fov_up": -25},
        {"fov_up": -30},
        {"fov_up": math.nan},
        {"fov_down": -math.inf},
        {"height": 0},
        {"width": -1},
        {"means": (0, 0, 0, 0)},
        {"stds": (1, 1, 1, 1)},
        {"stds": (1, 1, 1, 1, 0)},
        {"out_of_view": "wrap"},
        {"intensity_scale": 0},
        {"intensity_scale": 1e-40},
        {"stds": (1, 1, 1, 1, 1e-40)},
        {"stds": (1, 1, 1, 1, math.inf)},
        {"means": (1e30, 0, 0, 0, 0)},
        {"means": (math.nan, 0, 0, 0, 0)},
    ],
)
def test_impossible_sensors(change: dict[str, object]) -> None:
    with pytest.raises(UsageError, match="sensor valid"):
        Sensor.from_dict(VALID.to_dict() | change)


def test_what_a_size_would_take_is_said_before_it_is_taken() -> None:
    assert VALID.resized(width=32768).width == 32768
    with pytest.raises(UsageError) as caught:
        VALID.resized(4096, 4096)
    assert str(caught.value) == (
        "sensor valid · size 4096×4096, of which an image takes 16 GB in a network"
        " · expected at most 2097152 pixels, such as 64×32768"
    )
    with pytest.raises(UsageError, match=r"a number of \d+ bits"):
        VALID.resized(1 << 2000, 1 << 2000)


def test_unknown_and_missing_keys() -> None:
    with pytest.raises(UsageError, match="unknown key fov_upp"):
        Sensor.from_dict(VALID.to_dict() | {"fov_upp": 3})
    with pytest.raises(UsageError, match="height"):
        Sensor.from_dict({"name": "s", "fov_up": 1, "fov_down": 0, "width": 1})


@pytest.mark.parametrize(
    "change",
    [
        {"fov_up": "3"},
        {"height": "64"},
        {"height": 64.5},
        {"means": 1.0},
        {"means": ["a", "b", "c", "d", "e"]},
        {"stds": [1, 1, 1, 1, math.nan]},
        {"means": [0, 0, 0, 0, math.inf]},
        {"intensity_scale": "255"},
    ],
)
def test_values_of_another_type_are_the_users_mistake(change: dict[str, object]) -> None:
    with pytest.raises(UsageError):
        Sensor.from_dict(VALID.to_dict() | change)


def test_file(tmp_path: Path) -> None:
    path = tmp_path / "mein sensor.toml"
    path.write_text("fov_up = 10\nfov_down = -10.5\nheight = 16\nwidth = 900\n")
    own = sensor(path)
    assert own == Sensor("mein sensor", 10, -10.5, 16, 900)
    path.write_text(path.read_text() + 'name = "eigen"\nmeans = [1, 2, 3, 4, 5]\n')
    assert sensor(str(path)) == replace(own, name="eigen", means=(1, 2, 3, 4, 5))


@pytest.mark.parametrize(
    "text", ["fov_up = ", "fov_up = 1", "speed = 3\n", "[hdl64]\nfov_up = 3\n", "\xff"]
)
def test_bad_files(tmp_path: Path, text: str) -> None:
    path = tmp_path / "s.toml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(UsageError, match=r"s\.toml"):
        sensor(path)


def test_neither_preset_nor_file(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="one of hdl64"):
        sensor("hdl46")
    with pytest.raises(UsageError, match="no preset and no file"):
        sensor(tmp_path)


def test_resized() -> None:
    assert VALID.resized(width=512) == replace(VALID, width=512)
    assert VALID.resized(height=32) == replace(VALID, height=32)
    assert VALID.resized() == VALID
    with pytest.raises(UsageError):
        VALID.resized(width=-1)


@pytest.mark.parametrize("noise", [-0.01, math.nan, math.inf])
@pytest.mark.parametrize("name", ["range_noise", "intensity_noise"])
def test_a_noise_that_cannot_be(name, noise):
    with pytest.raises(UsageError, match=name):
        replace(sensor("hdl64"), **{name: noise})


def test_every_preset_knows_its_noise():
    assert all(preset.knows_noise for preset in presets().values())
    assert not Sensor("s", 3, -25, 64, 512).knows_noise
    assert not Sensor("s", 3, -25, 64, 512, range_noise=0.02).knows_noise


def test_the_view_is_all_but_name_and_noise():
    one = sensor("hdl64")
    assert one.view() == replace(one, name="x", range_noise=None, intensity_noise=1.0).view()
    assert one.view() != replace(one, out_of_view="drop").view()
    assert set(one.to_dict()) - set(one.view()) == {"name", "range_noise", "intensity_noise"}
