# SPDX-License-Identifier: MIT
import pytest
import torch
from tiny_network import TinyNetwork

from salsanext_cli.training.optimise import Learner
from salsanext_cli.training.precision import dtype_of
from salsanext_cli.training.recipe import Recipe

CPU, GPU = torch.device("cpu"), torch.device("cuda", 0)


def test_on_a_cpu_auto_is_float32() -> None:
    assert dtype_of("auto", CPU) is torch.float32
    for name in ("float32", "bfloat16", "float16"):
        assert dtype_of(name, CPU) is dtype_of(name, GPU) is getattr(torch, name)


@pytest.mark.parametrize(
    ("capability", "dtype"),
    [((9, 0), torch.bfloat16), ((8, 0), torch.bfloat16), ((7, 5), torch.float16)],
)
def test_on_a_gpu_auto_is_what_it_computes_fast(
    capability: tuple[int, int], dtype: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: capability)
    assert dtype_of("auto", GPU) is dtype


def stepped(precision: str) -> tuple[Learner, float, set[torch.dtype]]:
    """Return a learner after a step, the loss, and in what its last layer computed."""
    recipe = Recipe(precision=precision, dropout=0.0, clip_gradient=1.0)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        images = torch.randn(2, 5, 16, 32)
        learner = Learner.of(TinyNetwork(3, 0.0), recipe, torch.tensor([0.0, 1.0, 2.0]), CPU)
    seen = set()
    learner.module.register_forward_hook(lambda module, given, made: seen.add(made.dtype))
    return learner, learner.step(images, (images[:, 0] > 0).byte() + 1, 0, 1), seen


@pytest.mark.parametrize("precision", ["bfloat16", "float16"])
def test_shorter_types_compute_shorter_and_learn_the_same(precision: str) -> None:
    """Their rounding, 2⁻⁹ and 2⁻¹², is all that may tell the losses apart."""
    exact, loss, dtypes = stepped("float32")
    assert dtypes == {torch.float32}
    shorter, shorter_loss, dtypes = stepped(precision)
    assert dtypes == {getattr(torch, precision)}
    assert shorter_loss == pytest.approx(loss, rel=0.02)
    assert shorter_loss != loss
    weights = shorter.module.state_dict()
    for name, expected in exact.module.state_dict().items():
        assert weights[name].dtype == expected.dtype
        torch.testing.assert_close(weights[name], expected, rtol=0.05, atol=1e-3)


def test_only_float16_scales_its_gradients() -> None:
    enabled = {name: stepped(name)[0].scaler.is_enabled() for name in ("bfloat16", "float16")}
    assert enabled == {"bfloat16": False, "float16": True}


def test_gradients_that_overflow_in_float16_are_left_out_and_scaled_less() -> None:
    learner, _, _ = stepped("float16")
    before = {name: tensor.clone() for name, tensor in learner.module.named_parameters()}
    learner.scaler.update(2.0**40)
    images = torch.randn(2, 5, 16, 32, generator=torch.Generator().manual_seed(1))
    learner.step(images, torch.ones(2, 16, 32, dtype=torch.uint8), 1, 1)
    for name, parameter in learner.module.named_parameters():
        assert torch.equal(parameter, before[name])
    assert learner.scaler.get_scale() < 2.0**40
