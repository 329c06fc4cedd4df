# SPDX-License-Identifier: MIT
"""Checkpoint of a training: all that is needed to resume it, in one safetensors file.

Its tensors are those of ``module``, of ``average`` where it is another, and of the ``optimiser`` by
name of parameter, and the ``losses`` of the epoch. Progress, scaler and a checksum are in the
header. Nothing in it is ever unpickled.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

from salsanext_cli.errors import TrainingError, error_text
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.log import Row

KEY = "salsanext-checkpoint"  # The only key, as in weights files
DAMAGE = (safetensors.SafetensorError, OSError, LookupError, RuntimeError, TypeError, ValueError)
"""Errors that reading a damaged checkpoint may end in."""
OPTIMISER_STATE = {"sgd": ("momentum_buffer",), "adamw": ("step", "exp_avg", "exp_avg_sq")}
"""Names of the tensors that torch's optimisers keep for each parameter."""


@dataclass(slots=True)
class TrainingState:
    """Progress of a training."""

    epoch: int = 0  # Number of finished epochs
    best: float = -1.0  # Best validation mIoU; -1 before the first
    rows: list[Row] = field(default_factory=list)
    losses: list[float] = field(default_factory=list)  # Of the steps done of the current epoch
    seconds: float = 0.0  # That they took


def save_checkpoint(path: Path, learner: Learner, state: TrainingState) -> None:
    """Write the state after a step, atomically."""
    progress = asdict(state)
    tensors = dict(_networks(learner).state_dict())
    tensors["losses"] = torch.tensor(progress.pop("losses"), dtype=torch.float64)
    for name, parameter in learner.module.named_parameters():
        for key, value in learner.optimiser.state.get(parameter, {}).items():
            tensors[f"optimiser.{name}.{key}"] = value
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    values: dict[str, object] = {"progress": progress, "scaler": learner.scaler.state_dict()}
    values["sha256"] = _checksum(values, tensors)
    content = safetensors.torch.save(tensors, {KEY: json.dumps(values)})
    OwnedFolder(path.parent).write(path, content, durable=True)


def load_checkpoint(path: Path, learner: Learner) -> TrainingState:
    """Restore a saved state; `TrainingError` if damaged or of another network."""
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in [*file.keys()]}
            values = json.loads((file.metadata() or {})[KEY])
        if values.pop("sha256") != _checksum(values, tensors):
            raise ValueError("the checksum is wrong")
        state = TrainingState(**values["progress"], losses=tensors["losses"].tolist())
        learner.scaler.load_state_dict(values["scaler"])
        _restore(learner, tensors)
    except DAMAGE as error:
        found = f"cannot be resumed from: {error_text(error)}"
        hint = "start anew with --overwrite or in another folder"
        raise TrainingError(path, found, "a checkpoint of this training", hint) from error
    return state


def _networks(learner: Learner) -> nn.ModuleDict:
    """Return the module, and the average if it is another."""
    networks = nn.ModuleDict({"module": learner.module})
    if learner.average is not learner.module:
        networks["average"] = learner.average
    return networks


def _checksum(values: Mapping[str, object], tensors: Mapping[str, Tensor]) -> str:
    """Return the SHA-256 of values and tensors, but for the types and shapes of these."""
    digest = hashlib.sha256(json.dumps(values).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(name.encode())
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()


@torch.no_grad()
def _restore(learner: Learner, tensors: Mapping[str, Tensor]) -> None:
    """Copy tensors into a learner; a missing one, or one of another shape, is an error."""
    networks = _networks(learner)
    networks.load_state_dict({name: tensors[name] for name in networks.state_dict()})
    learner.optimiser.state.clear()
    for name, parameter in learner.module.named_parameters():
        keys = {key: f"optimiser.{name}.{key}" for key in OPTIMISER_STATE[learner.recipe.optimiser]}
        # Parameters have none before the first step, or if they are never used.
        if tensors.keys() & {*keys.values()}:
            # AdamW's step is on the device if fused, else on the CPU: no parameter waits for it.
            step_device = parameter.device if learner.optimiser.defaults["fused"] else "cpu"
            learner.optimiser.state[parameter] = {
                key: tensors[of_parameter].to(step_device)
                if key == "step"
                else torch.empty_like(parameter).copy_(tensors[of_parameter])
                for key, of_parameter in keys.items()
            }
