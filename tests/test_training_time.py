# SPDX-License-Identifier: MIT
"""The rule for the hours of a training, as the tutorial on the paper states it."""

import re
from pathlib import Path

import pytest

from salsanext_cli.commands.line.values.recipe_changes import read_overrides
from salsanext_cli.training.data.dataset import SamplingPlan
from salsanext_cli.training.recipe import recipe

PAGE = (Path(__file__).parents[1] / "docs/tutorials/paper.md").read_text("utf-8")


def test_the_factor_of_the_page_is_that_of_the_recipe_and_of_its_command():
    (command,) = re.findall(r"^salsanext train .* runs/speed .*$", PAGE, re.M)
    trial = recipe("paper").with_changes(**read_overrides(re.findall(r"--set (\S+)", command)))
    measured = SamplingPlan(scan_counts=[19_130], recipe=trial).steps_per_epoch * trial.batch
    whole = SamplingPlan(scan_counts=[19_130], recipe=recipe("paper"))
    hours_per_second = whole.steps * trial.batch / measured / 3600
    factor = float(re.search(r"= ([\d.]+) × seconds", PAGE)[1])
    assert factor == pytest.approx(hours_per_second, abs=0.005)
    assert f"19 130 × {recipe('paper').epochs} / ({measured} / seconds)" in PAGE
