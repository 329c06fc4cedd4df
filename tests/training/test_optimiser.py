# SPDX-License-Identifier: MIT
import pytest
import torch
from torch import nn

from salsanext_cli.training.optimiser import (
    build_optimiser,
    dtype_of,
    learning_rate,
    update_average,
)
from salsanext_cli.training.recipe import Recipe


def test_sgd_is_the_papers() -> None:
    """Two steps against the update rule written out: momentum 0.9, decay added to the gradient."""
    weight = torch.tensor([2.0])
    layer = nn.Linear(1, 1, bias=False)
    layer.weight.data[:] = weight
    optimiser = build_optimiser(layer, Recipe())
    speed = torch.zeros(1)
    for _ in range(2):
        optimiser.zero_grad()
        layer(torch.ones(1, 1)).square().sum().backward()
        optimiser.step()
        speed = 0.9 * speed + 2 * weight + 1e-4 * weight
        weight = weight - 0.01 * speed
    torch.testing.assert_close(layer.weight.detach()[0], weight)


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
    warm_up = 0.3 * epochs - 1 / steps
    recipe = Recipe(epochs=epochs, schedule="one-cycle", learning_rate=0.003, warm_up=warm_up)
    optimiser = torch.optim.SGD([nn.Parameter(torch.zeros(1))], lr=1.0, momentum=0.9)
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
    assert all(0 < learning_rate(recipe, step, 1) <= 0.1 for step in range(2))


def test_the_average_takes_batch_norm_along_and_forgets_the_random_weights_soon() -> None:
    kept, new = nn.BatchNorm2d(1), nn.BatchNorm2d(1)
    new.weight.data.fill_(3.0)
    new.running_mean.fill_(1.0)
    new.num_batches_tracked.fill_(7)
    update_average(kept, new, 0.9, step=1000)
    assert float(kept.weight.detach()) == pytest.approx(1.2)
    assert float(kept.running_mean) == pytest.approx(0.1)
    assert int(kept.num_batches_tracked) == 7
    for step in range(30):
        update_average(kept, new, 0.999, step)
    assert float(kept.weight.detach()) > 2.98


@pytest.mark.parametrize(
    ("precision", "capability", "dtypes"),
    [
        ("auto", (9, 0), (torch.float32, torch.bfloat16)),
        ("auto", (8, 0), (torch.float32, torch.bfloat16)),
        ("auto", (7, 5), (torch.float32, torch.float16)),
        ("bfloat16", (7, 5), (torch.bfloat16, torch.bfloat16)),
    ],
)
def test_auto_is_float32_on_cpus_and_what_gpus_compute_fast(
    precision: str,
    capability: tuple[int, int],
    dtypes: tuple[torch.dtype, torch.dtype],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: capability)
    devices = (torch.device("cpu"), torch.device("cuda", 0))
    assert tuple(dtype_of(precision, device) for device in devices) == dtypes
