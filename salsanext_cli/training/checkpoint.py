# SPDX-License-Identifier: MIT
"""Checkpoint of a training: all that is needed to resume it, in one safetensors file.

Its tensors are those of ``module``, of ``average`` where it is another, and of the ``optimiser`` by
name of parameter, and the ``losses`` of the epoch. Progress, scaler and a checksum are in the
header. Nothing in it is ever unpickled.
"""

import hashlib
import json
from collections import defaultdict
from collections.abc import Mapping, Set
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
import torch
from torch import Tensor

from salsanext_cli.errors import FormatError, TrainingError
from salsanext_cli.formats.reading import reading
from salsanext_cli.settings_files import words_of
from salsanext_cli.storage.written_files import WrittenFiles
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.log import Row

KEY = "salsanext-checkpoint"
"""The one key of the header: safetensors writes several in an order drawn anew each time."""
OPTIMISER_STATE = {"sgd": ("momentum_buffer",), "adamw": ("step", "exp_avg", "exp_avg_sq")}
"""Names of the tensors that torch's optimisers keep for each parameter."""
DAMAGE = (
    *(FormatError, safetensors.SafetensorError, OSError, ArithmeticError, LookupError, TypeError),
    *(ValueError, RecursionError, RuntimeError),
)
"""Errors that reading a damaged checkpoint may end in."""
OptimiserState = dict[Tensor, dict[str, Tensor]]
"""Tensors that an optimiser keeps, by parameter and name."""


@dataclass(slots=True)
class TrainingState:
    """Progress of a training.

    Attributes
    ----------
    epoch : int
        Finished epochs.
    best : float
        Best validation mIoU so far; -1 before the first.
    rows : list of Row
        The log so far, a row per epoch.
    losses : list of float
        Of the steps that are done of the current epoch.
    seconds : float
        Time that these steps took.
    """

    epoch: int = 0
    best: float = -1.0
    rows: list[Row] = field(default_factory=list)
    losses: list[float] = field(default_factory=list)
    seconds: float = 0.0


def save_checkpoint(path: Path, learner: Learner, state: TrainingState) -> None:
    """Write the state after a step, atomically."""
    progress = asdict(state)
    tensors = _named(learner, learner.optimiser.state)
    tensors["losses"] = torch.tensor(progress.pop("losses"), dtype=torch.float64)
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    values: dict[str, Any] = {"progress": progress, "scaler": learner.scaler.state_dict()}
    values["sha256"] = _checksum(values, tensors)
    content = safetensors.torch.save(tensors, {KEY: json.dumps(values)})
    WrittenFiles(path.parent).write(path, content, durable=True)


def load_checkpoint(path: Path, learner: Learner) -> TrainingState:
    """Restore a saved state; no more is read than the learner has room for.

    Raises
    ------
    TrainingError
        If the file is damaged or of another network or optimiser.
    """
    try:
        with reading(path), safetensors.safe_open(path, framework="pt") as file:
            names = {*file.keys()}
            optimised = _optimiser_state(learner, names)
            slots = _named(learner, optimised)
            if unlike := names ^ {*slots, "losses"}:
                raise ValueError(f"{min(unlike)} is of another network or optimiser, or is missing")
            for name, tensor in slots.items():
                if file.get_slice(name).get_shape() != [*tensor.shape]:
                    raise ValueError(f"{name} is of another shape")
            values = json.loads((file.metadata() or {})[KEY])
            tensors = {name: file.get_tensor(name) for name in names}
        if values.pop("sha256") != _checksum(values, tensors):
            raise ValueError("the checksum is wrong")
        state = TrainingState(**values["progress"], losses=tensors.pop("losses").tolist())
        if state.epoch > learner.recipe.epochs:
            raise ValueError(f"epoch {state.epoch} of {learner.recipe.epochs}")
        if values["scaler"].keys() != learner.scaler.state_dict().keys():
            raise ValueError("a scaler of another precision")
    except DAMAGE as error:
        raise TrainingError(
            path,
            f"cannot be resumed from: {words_of(error)}",
            "a checkpoint of this training",
            "start anew with --overwrite or in another folder",
        ) from error
    for name, tensor in tensors.items():
        slots[name].copy_(tensor)
    learner.optimiser.state.clear()
    learner.optimiser.state.update(optimised)
    learner.scaler.load_state_dict(values["scaler"])
    return state


def _named(learner: Learner, optimised: OptimiserState) -> dict[str, Tensor]:
    """Return the tensors of the networks, the average if it is another, and of the optimiser."""
    named = {f"module.{name}": t for name, t in learner.module.state_dict().items()}
    if learner.average is not learner.module:
        named |= {f"average.{name}": t for name, t in learner.average.state_dict().items()}
    for name, parameter in learner.module.named_parameters():
        for key, tensor in optimised.get(parameter, {}).items():
            named[f"optimiser.{name}.{key}"] = tensor
    return named


def _optimiser_state(learner: Learner, names: Set[str]) -> OptimiserState:
    """Return tensors to put into what a checkpoint of these names holds of the optimiser."""
    state: OptimiserState = defaultdict(dict)
    for name, parameter in learner.module.named_parameters():
        for key in OPTIMISER_STATE[learner.recipe.optimiser]:
            if f"optimiser.{name}.{key}" in names:
                # The count of steps stays on the CPU: on a GPU every parameter would wait for it.
                like = torch.zeros(()) if key == "step" else torch.empty_like(parameter)
                state[parameter][key] = like.detach()
    return state


def _checksum(values: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> str:
    """Return the SHA-256 of values and tensors."""
    digest = hashlib.sha256(json.dumps(values).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(name.encode())
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()
