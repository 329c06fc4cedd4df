# SPDX-License-Identifier: MIT
"""Gradients and more of workers; `forked_workers` starts them as torchrun does."""

from pathlib import Path

import torch
from tiny_network import TinyNetwork
from torch import Tensor, nn

from salsanext_cli.core.errors import TrainingError
from salsanext_cli.training.distributed import ProcessGroup, process_group
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.recipe import Recipe

RESULTS = "two_workers.pt"
WEIGHTS = torch.tensor([0.0, 1.0, 2.0, 0.5])
CASES: dict[str, dict[str, object]] = {
    "both losses": {},
    "clipped": {"clip_gradient": 0.01},
    "in parts": {"lovasz": 0.0, "accumulate": 2},
    "nothing labelled": {"labels": 0},
    "bfloat16": {"precision": "bfloat16"},
    "sets of classes": {"sets": ((1, 2),)},
}
FLOAT = {"float32": torch.float64, "bfloat16": torch.float32}
"""Type of weights and images: only float32 is computed in bfloat16, float64 stays as it is."""


def network(dropout: float = 0.0, *, norm: bool = False) -> TinyNetwork:
    """Return a network of convolutions and dropout, and of batch norm if that is wanted."""
    module = TinyNetwork(4, dropout)
    module.features = nn.Sequential(module.features, nn.Conv2d(8, 8, 1))  # type: ignore[assignment]
    if not norm:
        module.norm = nn.Identity()  # type: ignore[assignment]
    return module


def batch(labels: int = 1) -> tuple[Tensor, Tensor]:
    """Return images of unlike shares of labels; class 3 is in the first, so of one worker, only."""
    random = torch.Generator().manual_seed(4)
    images = torch.randn(5, 5, 8, 16, generator=random, dtype=torch.float64)
    truth = (images[:, 0] > torch.linspace(-1, 1, 5)[:, None, None]).byte() + 1
    truth[1, :, 5:] = 0
    truth[0, 3] = 3
    return images, truth * labels


def share(whole: Tensor, group: ProcessGroup) -> Tensor:
    """Return a worker's part of a batch as `SamplingPlan` deals it."""
    return whole[group.rank :: group.size]


def learner(group, *, norm=False, sets=(), **changes):
    """Return the same network in every process."""
    recipe = Recipe(batch=5, dropout=0.0, learning_rate=0.1, **changes)  # type: ignore[arg-type]
    with torch.random.fork_rng():
        torch.manual_seed(0)
        module = network(norm=norm).to(FLOAT[recipe.precision])
    return Learner(module, recipe, WEIGHTS, torch.device("cpu"), group, sets)  # type: ignore[arg-type]


def stepped(group: ProcessGroup, case: str) -> dict[str, Tensor]:
    """Return loss, gradients and weights after a step of a case."""
    changes = dict(CASES[case])
    images, truth = batch(changes.pop("labels", 1))  # type: ignore[arg-type]
    if "sets" in changes:
        truth[1:4, 2] = len(WEIGHTS)
    learning = learner(group, **changes)  # type: ignore[arg-type]
    images = images.to(FLOAT[learning.recipe.precision])
    results = {"loss": learning.step(share(images, group), share(truth, group), 5, 1)}
    for name, parameter in learning.module.named_parameters():
        assert parameter.grad is not None
        results[f"gradient of {name}"] = parameter.grad
        results[name] = parameter.detach()
    return results


def normed(group: ProcessGroup) -> dict[str, Tensor]:
    """Return the running means of all workers after a step, and after a broadcast."""
    learning = learner(group, norm=True, average=0.5)
    learning.step(*(share(whole, group) for whole in batch()), 5, 1)
    before = torch.stack(group.gather(learning.average.norm.running_mean))  # type: ignore[union-attr]
    group.broadcast(learning.average.buffers())
    after = torch.stack(group.gather(learning.average.norm.running_mean))  # type: ignore[union-attr]
    weight = torch.stack(group.gather(learning.average.features[0].weight[0, 0, 0]))  # type: ignore
    return {"own": before, "after": after, "weight": weight.detach()}


def apart(group: ProcessGroup) -> dict[str, Tensor]:
    """Return what dropout drops, what `on_main` returns and what is gathered, of all workers."""
    module = network(0.5)
    module.features[1].bias.data.fill_(100.0)  # so that only dropout leaves nothing
    masks = []
    module.dropout.register_forward_hook(lambda layer, given, made: masks.append(made.detach()))
    recipe = Recipe(batch=2, dropout=0.5)
    one = Learner(module, recipe, WEIGHTS, torch.device("cpu"), group)  # type: ignore[arg-type]
    one.step(torch.ones(1, 5, 8, 16), torch.ones(1, 8, 16, dtype=torch.uint8), 3, 1)
    dropped = (masks[0] == 0).all(dim=(0, 2, 3))
    on_main = group.on_main(lambda: 10 + group.rank)
    uneven = group.gather(torch.full((2, 1 + group.rank), float(group.rank)))
    return {
        "dropped": torch.stack(group.gather(dropped.byte())),
        "on_main": torch.cat(group.gather(torch.tensor([on_main]))),
        "uneven": torch.cat(uneven, 1),
    }


def refused(group: ProcessGroup) -> bool:
    """Return whether an error of the main worker reaches this one unchanged."""

    def fail() -> None:
        raise TrainingError("data", "problem", "expected", f"hint of {group.rank}")

    try:
        group.on_main(fail)
    except TrainingError as error:
        return (error.subject, error.hint) == ("data", "hint of 0")
    return False


def write_results(folder: Path) -> None:
    """Write the results of two workers."""
    with process_group("cpu") as (group, _):
        results: dict[str, object] = {case: stepped(group, case) for case in CASES}
        results["normed"], results["apart"] = normed(group), apart(group)
        results["refused"] = torch.cat(group.gather(torch.tensor([refused(group)]).byte()))
        results["size"] = group.size
        if group.is_main:
            torch.save(results, folder / RESULTS)
