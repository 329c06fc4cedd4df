# SPDX-License-Identifier: MIT
"""Memory that a step of a training needs, and settings that fit."""

import re

import pytest

from salsanext_cli.commands.line.values.recipe_changes import read_overrides
from salsanext_cli.core.errors import TrainingError
from salsanext_cli.io.sensors import sensor
from salsanext_cli.training.memory import Memory
from salsanext_cli.training.recipe import recipe
from salsanext_cli.training.step_memory import BYTES_PER_PIXEL, StepMemory

PAPER = recipe("paper")
PIXELS = 64 * 2048
OF_PIXEL = BYTES_PER_PIXEL["cpu", "float32"]
GB = 10**9


def step(plan=PAPER, device="cpu", **numbers):
    return StepMemory.from_recipe(plan, sensor("hdl64"), device, **numbers)


@pytest.mark.parametrize(
    ("changes", "images", "pixels"),
    [
        ({}, 24, 24 * PIXELS),
        ({"accumulate": 4}, 6, 6 * PIXELS),
        ({"accumulate": 100}, 1, PIXELS),
        ({"crop_width": 512}, 24, 24 * PIXELS / 4),
        ({"crop_width": 512, "widths": "512,1024,2048"}, 24, 24 * PIXELS / 4),
        ({"crop_width": 9000}, 24, 24 * PIXELS),
    ],
)
def test_a_step_needs_the_memory_of_the_images_that_are_computed_at_once(changes, images, pixels):
    of_recipe = step(PAPER.with_changes(**changes))
    assert of_recipe.images == images
    assert of_recipe.needed == pixels * OF_PIXEL


def test_workers_share_a_batch_and_on_a_cpu_the_memory():
    assert step(workers=4).needed == 6 * PIXELS * OF_PIXEL
    assert step(workers=4, sharing=4).needed == 24 * PIXELS * OF_PIXEL


def test_an_unknown_network_is_not_judged():
    assert step(PAPER.with_changes(architecture="rangenet53")) is None


def test_the_paper_does_not_fit_a_machine_that_it_filled():
    """A batch of 24 whole images was killed at 21.6 GB."""
    with pytest.raises(TrainingError) as caught:
        step().require_fits(Memory(total=24 * GB, available=20 * GB))
    assert caught.value.subject == "memory"


@pytest.mark.parametrize("total", [1, 4, 10, 24, 48])
@pytest.mark.parametrize("workers", [1, 3])
def test_each_setting_of_the_hint_fits(total, workers):
    memory = Memory(total=total * GB, available=int(0.9 * total * GB))
    with pytest.raises(TrainingError) as caught:
        step(workers=workers, sharing=workers).require_fits(memory)
    settings = [read_overrides([text]) for text in re.findall(r"(\w+=\d+)", caught.value.hint)]
    settings = [{key: value} for changes in settings for key, value in changes.items()]
    if "narrower" in caught.value.hint:
        settings = [settings[0] | settings[1]]
    assert settings
    for changes in settings:
        step(PAPER.with_changes(**changes), workers=workers, sharing=workers).require_fits(memory)


def test_memory_that_others_use_is_a_warning(caplog):
    step().require_fits(Memory(total=100 * GB, available=20 * GB))
    assert "20 GB are available" in caplog.text
    assert "use accumulate=4 " in caplog.text
    caplog.clear()
    step().require_fits(Memory(total=100 * GB, available=64 * GB))
    step().require_fits(Memory(total=100 * GB, available=step().room))
    assert not caplog.text
