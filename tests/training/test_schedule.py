# SPDX-License-Identifier: MIT
import pytest
import torch

from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.schedule import learning_rate


def test_decay_warms_up_then_falls_by_a_hundredth_per_epoch() -> None:
    recipe = Recipe(learning_rate=0.01, epochs=5)
    rates = [learning_rate(recipe, step, 10) for step in range(50)]
    assert rates[0] == pytest.approx(0.001)
    assert rates[:10] == sorted(rates[:10])
    assert rates[9] == pytest.approx(0.01)
    assert rates[10:20] == pytest.approx([0.01] * 10)
    assert rates[20:30] == pytest.approx([0.0099] * 10)
    assert rates[49] == pytest.approx(0.01 * 0.99**3)


def test_one_cycle_is_torchs() -> None:
    epochs, steps = 4, 25
    recipe = Recipe(
        epochs=epochs, schedule="one-cycle", learning_rate=0.003, warm_up=0.3 * epochs - 1 / steps
    )
    parameter = torch.nn.Parameter(torch.zeros(1))
    optimiser = torch.optim.SGD([parameter], lr=1.0, momentum=0.9)
    cycle = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, 0.003, epochs * steps, pct_start=0.3, cycle_momentum=False
    )
    for step in range(epochs * steps):
        assert learning_rate(recipe, step, steps) == pytest.approx(cycle.get_last_lr()[0])
        optimiser.step()
        if step + 1 < epochs * steps:
            cycle.step()


@pytest.mark.parametrize("schedule", ["decay", "one-cycle"])
@pytest.mark.parametrize("warm_up", [0.0, 1.0, 5.0])
def test_any_warm_up_gives_a_rate_above_zero_and_no_more_than_the_peak(
    schedule: str, warm_up: float
) -> None:
    recipe = Recipe(epochs=2, schedule=schedule, warm_up=warm_up, learning_rate=0.1)
    rates = [learning_rate(recipe, step, 1) for step in range(2)]
    assert all(0 < rate <= 0.1 for rate in rates)
