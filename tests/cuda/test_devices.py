# SPDX-License-Identifier: MIT
"""A GPU computes what a CPU does. All tests run on the CPU too, so that they work when a GPU comes.

The expected values are those of single scans, of loops and of steps that are written out, all
on the CPU.
"""

import copy
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from devices import on_both, waits_refused
from scans import SMALL, make_scan, share_alike, write_sequence
from shallow_network import shallow, weights  # noqa: F401
from tiny_network import CLASS_WEIGHTS, batch, learner
from torch import Tensor

from salsanext_cli import RangeImage, load_network, project
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.commands.stages.train import train
from salsanext_cli.core.engines import torch_backend
from salsanext_cli.core.engines.batches import BatchSize
from salsanext_cli.core.network.dropout import random_masks, sampling
from salsanext_cli.core.records import Float
from salsanext_cli.core.uncertainty.monte_carlo import pass_seed, sample
from salsanext_cli.io.weights.weights import read_weights
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.training.checkpoint import TrainingState, load_checkpoint, save_checkpoint
from salsanext_cli.training.recipe import Recipe

STEPS = 5
"""Of an epoch."""


@pytest.fixture
def file(request: pytest.FixtureRequest) -> Path:
    """Return the weights file of a shallow network."""
    path: Path = request.getfixturevalue("weights")
    return path


@pytest.fixture
def image() -> RangeImage:
    return project(make_scan(4000), SMALL)


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    return write_sequence(tmp_path / "data/sequences/00", map(str, range(5)))


@on_both("float32", "float16", "bfloat16")
def test_batches_have_the_labels_of_single_scans(file, scans, tmp_path, device, precision):
    one = NetworkSettings(file, "cpu", engine="torch")
    predict_scans(scans, tmp_path / "one", settings=one, batch=1)
    there = replace(one, device=device, precision=precision)
    predict_scans(scans, tmp_path / "batches", settings=there, batch=4)
    assert share_alike(tmp_path / "batches", tmp_path / "one") >= 0.99


@on_both("float32")
def test_a_batch_is_halved_until_it_fits(file, image, device, precision, monkeypatch):
    # A recorded call has no hooks.
    monkeypatch.setattr(torch_backend, "MAX_GRAPH_PIXELS", 0)
    network = load_network(file, device, SMALL, precision, "torch")
    inputs = [network.input(image.channels * np.float32(1 - 0.1 * i)) for i in range(5)]
    expected = [network.backend.predict([each], 1.0)[0].confidence for each in inputs]
    sizes = []

    def short_of_memory(_: object, inputs: tuple[Tensor]) -> None:
        sizes.append(len(inputs[0]))
        if sizes[-1] > 1:
            raise torch.OutOfMemoryError("no room")

    # On a copy: other tests have the same module.
    module = copy.deepcopy(network.module)
    module.register_forward_pre_hook(short_of_memory)
    backend = replace(network.backend, load_module=lambda: module)

    def confidences(some: Sequence[Float]) -> list[Float]:
        return [each.confidence for each in backend.predict(some, 1.0)]

    batches = BatchSize(5, "images").in_batches(confidences, inputs)
    found = [each for batch in batches for each in batch]
    assert sizes == [5, 2, 1, 1, 1, 1, 1]
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4)


@on_both("float32", "float16")
def test_sampling_has_the_masks_of_its_seed(file, image, device, precision):
    """Mean and variance of passes that are computed one by one in float64."""
    network = load_network(file, device, SMALL, precision, "torch")
    found = sample(network, image, samples=6, seed=3)
    module = read_weights(file)[0].double()
    passes = []
    for number in range(6):
        generator = torch.Generator().manual_seed(pass_seed(3, number))
        with torch.no_grad(), sampling(random_masks([generator])):
            logits = module(torch.from_numpy(network.input(image.channels)).double())
        passes.append(logits.softmax(1)[0].numpy())
    tolerance = 1e-5 if precision == "float32" else 2e-2
    np.testing.assert_allclose(found.probabilities, np.mean(passes, axis=0), atol=tolerance)
    expected = np.var(passes, axis=0)
    assert expected.max() > 10 * tolerance
    np.testing.assert_allclose(found.variance, expected, atol=tolerance)


# Training


@on_both("float32", "bfloat16")
def test_a_step_of_training(device: str, precision: str) -> None:
    """The gradient of a weighted cross-entropy, and what SGD makes of it."""
    learning = learner(device, precision=precision, lovasz=0.0, dropout=0.0, learning_rate=0.1)
    before = copy.deepcopy(learning.module).cpu().float()
    images, truth = batch(0)
    loss = learning.step(images, truth, 0, STEPS).item()
    expected = F.cross_entropy(before.train()(images), truth.long(), CLASS_WEIGHTS)
    expected.backward()
    tolerance = 1e-3 if precision == "float32" else 3e-2
    assert loss == pytest.approx(expected.item(), rel=tolerance)
    for mine, plainly in zip(learning.module.parameters(), before.parameters(), strict=True):
        torch.testing.assert_close(mine.grad.cpu(), plainly.grad, rtol=tolerance, atol=tolerance)
        moved = plainly - 0.1 * (mine.grad.cpu() + 1e-4 * plainly)
        torch.testing.assert_close(mine.detach().cpu(), moved.detach(), rtol=1e-5, atol=1e-6)


@on_both("float32", "bfloat16", "float16")
@pytest.mark.parametrize("optimiser", ["sgd", "adamw"])
def test_a_step_without_a_finite_loss_changes_no_weight(device, precision, optimiser):
    """And the next one learns."""
    learning = learner(device, precision=precision, optimiser=optimiser, average=0.9)
    before = copy.deepcopy(learning.module)
    images, truth = batch(0)
    images[1, 2, 3, 4] = math.nan
    learning.scaler.scale(torch.zeros((), device=device))
    learning.scaler.update(1024.0)  # No gradient overflows.
    assert math.isnan(learning.step(images, truth, 0, STEPS))
    for one, other in zip(learning.module.parameters(), before.parameters(), strict=True):
        assert torch.equal(one, other)
    assert learning.step(*batch(1), 1, STEPS).isfinite()
    for one, other in zip(learning.module.parameters(), before.parameters(), strict=True):
        assert not torch.equal(one, other)
        assert one.isfinite().all()


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
@pytest.mark.filterwarnings("ignore:Synchronization debug mode")
@pytest.mark.parametrize("precision", ["float32", "bfloat16", "float16"])
def test_a_step_waits_for_nothing(precision: str) -> None:
    """On the CPU `test_the_host_waits_for_nothing_in_a_step` says the same."""
    learning = learner("cuda", precision=precision, average=0.9, clip_gradient=1.0)
    images, truth = (each.pin_memory() for each in batch(0))
    learning.step(images, truth, 0, STEPS)
    with waits_refused():
        learning.step(images, truth, 1, STEPS)


@on_both("float32", "float16")
@pytest.mark.parametrize("optimiser", ["sgd", "adamw"])
def test_a_resumed_training_goes_on_as_one_that_was_not(tmp_path, device, precision, optimiser):
    changes = {"precision": precision, "optimiser": optimiser, "average": 0.9, "dropout": 0.5}
    whole, first, resumed = (learner(device, **changes) for _ in range(3))
    for step in range(4):
        whole.step(*batch(step), step, STEPS)
    for step in range(2):
        first.step(*batch(step), step, STEPS)
    save_checkpoint(tmp_path / "c.safetensors", first, TrainingState(losses=[1.0, 2.0]))
    assert load_checkpoint(tmp_path / "c.safetensors", resumed).losses == [1.0, 2.0]
    for step in range(2, 4):
        resumed.step(*batch(step), step, STEPS)
    for one, other in ((whole.module, resumed.module), (whole.average, resumed.average)):
        for name, tensor in one.state_dict().items():
            torch.testing.assert_close(tensor, other.state_dict()[name], rtol=1e-3, atol=1e-5)
    assert resumed.scaler.state_dict() == whole.scaler.state_dict()


@on_both("float32", "bfloat16")
@pytest.mark.usefixtures("tiny_training")
def test_a_whole_training(tmp_path: Path, device: str, precision: str) -> None:
    """On a GPU worker processes prepare the samples; `test_samples` has those of a device."""
    write_sequence(tmp_path / "data/sequences/00", ["0", "1", "2"], count=600)
    write_sequence(tmp_path / "data/sequences/08", ["0"], count=600)
    changes = {"epochs": 2, "batch": 2, "crop_width": 32, "average": 0.5, "precision": precision}
    recipe = Recipe().with_changes(**changes)
    result = train(
        tmp_path / "data",
        tmp_path / "run",
        recipe=recipe,
        sensor=SMALL,
        device=device,
        samples="workers",
    )
    assert [row["epoch"] for row in result.rows] == [1, 2]
    assert all(math.isfinite(row["loss"]) and row["miou"] >= 0 for row in result.rows)
    settings = NetworkSettings(result.best, device, engine="torch")
    found = predict_scans(tmp_path / "data/sequences/08", tmp_path / "out", settings=settings)
    assert not found.failures
