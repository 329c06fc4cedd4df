# SPDX-License-Identifier: MIT
"""Checkpoint of a training: all that is needed to resume it, in one safetensors file.

The tensors are those of ``module``, of ``average`` if the recipe has one, the state of the
``optimiser`` by name of the parameter, and the ``losses`` of the unfinished epoch. The header holds
the progress, the state of the scaler and a checksum. Nothing is unpickled.
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

from salsanext_cli.core.errors import TrainingError
from salsanext_cli.core.texts import error_text
from salsanext_cli.core.wording import setting
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.training.fused_step import is_fused
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.run_folder import Row

KEY = "salsanext-checkpoint"  # The only key, as in weights files
DAMAGE = (safetensors.SafetensorError, OSError, LookupError, RuntimeError, TypeError, ValueError)
"""Errors of reading a damaged checkpoint."""


@dataclass(slots=True, kw_only=True)
class TrainingState:
    """Progress of a training."""

    epoch: int = 0  # Number of finished epochs
    best: float = -1.0  # Best validation mIoU; -1 before the first validation
    rows: list[Row] = field(default_factory=list)
    losses: list[float] = field(default_factory=list)  # Of the steps of the unfinished epoch
    seconds: float = 0.0  # Duration of these steps


def save_checkpoint(path: Path, learner: Learner, state: TrainingState) -> None:
    """Write the state after a step atomically."""
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
    """Restore a saved state; `TrainingError` if it is damaged or of another network."""
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
        raise _damaged(path, error) from error
    return state


def finished_epochs(path: Path) -> int:
    """Return the number of finished epochs of a checkpoint; `TrainingError` if it is damaged."""
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            return int(json.loads((file.metadata() or {})[KEY])["progress"]["epoch"])
    except DAMAGE as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> TrainingError:
    """Return the error of a damaged checkpoint."""
    hint = f"start again with {setting('overwrite', True)} or in another folder"
    problem = f"cannot be read: {error_text(error)}"
    return TrainingError(path, problem, "a checkpoint of this training", hint)


def _networks(learner: Learner) -> nn.ModuleDict:
    """Return the module, and the average if it is another."""
    networks = nn.ModuleDict({"module": learner.module})
    if learner.average is not learner.module:
        networks["average"] = learner.average
    return networks


def _checksum(values: Mapping[str, object], tensors: Mapping[str, Tensor]) -> str:
    """Return the SHA-256 of the values and the content of the tensors."""
    digest = hashlib.sha256(json.dumps(values).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(name.encode())
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()


@torch.no_grad()
def _restore(learner: Learner, tensors: Mapping[str, Tensor]) -> None:
    """Copy tensors into a learner; a missing tensor or another shape is an error."""
    networks = _networks(learner)
    networks.load_state_dict({name: tensors[name] for name in networks.state_dict()})
    learner.optimiser.state.clear()
    for name, parameter in learner.module.named_parameters():
        prefix = f"optimiser.{name}."
        saved = {key.removeprefix(prefix): key for key in tensors if key.startswith(prefix)}
        # AdamW's step is on the device if fused, else on the CPU: no parameter waits for it.
        step_device = parameter.device if is_fused(learner.optimiser) else "cpu"
        # Parameters have no state before the first step, or if they are never used.
        if saved:
            learner.optimiser.state[parameter] = {
                key: tensors[stored].to(step_device)
                if key == "step"
                else torch.empty_like(parameter).copy_(tensors[stored])
                for key, stored in saved.items()
            }
