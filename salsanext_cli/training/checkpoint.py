# SPDX-License-Identifier: MIT
"""All that is needed to go on after an interruption, in one file of tensors and plain numbers."""

from __future__ import annotations

import warnings
from dataclasses import asdict, dataclass, field
from pathlib import Path
from zipfile import BadZipFile, ZipFile

import torch

from salsanext_cli.errors import TrainingError
from salsanext_cli.network.torch_files import UNREADABLE, require_stored
from salsanext_cli.settings_files import shortened
from salsanext_cli.storage.atomic import writing
from salsanext_cli.training.log import Row
from salsanext_cli.training.optimise import Learner


@dataclass(slots=True)
class TrainingState:
    """How far a training has come.

    Attributes
    ----------
    epoch : int
        Epochs finished.
    best : float
        Best validation mIoU so far; -1 before the first.
    rows : list of Row
        The log so far, a row per epoch.
    losses : list of float
        Of the steps done of the epoch at work.
    seconds : float
        What these steps took.
    """

    epoch: int = 0
    best: float = -1.0
    rows: list[Row] = field(default_factory=list)
    losses: list[float] = field(default_factory=list)
    seconds: float = 0.0


def save_checkpoint(path: Path, learner: Learner, progress: TrainingState) -> None:
    """Write the state after a step, atomically."""
    state = {
        "module": learner.module.state_dict(),
        "average": learner.average.state_dict(),
        "optimiser": learner.optimiser.state_dict(),
        "scaler": learner.scaler.state_dict(),
        "progress": asdict(progress),
    }
    with writing(path, durable=True) as file:
        torch.save(state, file)


def load_checkpoint(path: Path, learner: Learner) -> TrainingState:
    """Put a saved state back; only tensors and plain values are ever unpickled.

    Raises
    ------
    TrainingError
        If the file is damaged or of another network or optimiser.
    """
    try:
        _require_intact(path)
        # To the CPU: on a GPU the optimiser's step counts would make it wait at every parameter.
        with warnings.catch_warnings():
            # Of forms that torch then refuses.
            warnings.simplefilter("ignore")
            state = torch.load(path, map_location="cpu", weights_only=True)
        learner.module.load_state_dict(state["module"])
        learner.average.load_state_dict(state["average"])
        learner.optimiser.load_state_dict(state["optimiser"])
        learner.scaler.load_state_dict(state["scaler"])
        return _checked(TrainingState(**state["progress"]))
    except (*UNREADABLE, OSError) as error:
        raise TrainingError(
            path,
            f"cannot be resumed from: {' '.join(str(error).split())[:200]}",
            "a checkpoint of this training",
            "start anew with --overwrite or in another folder",
        ) from error


def _checked(state: TrainingState) -> TrainingState:
    """Return a state that is of plain numbers; anything else raises `TypeError`."""
    numbers = [state.best, state.seconds, *state.losses]
    for row in state.rows:
        numbers += [row["epoch"], row["loss"], *row.values()]
    if type(state.epoch) is not int or state.epoch < 0:
        raise TypeError(f"an epoch that is none: {shortened(state.epoch)}")
    if any(type(number) not in (int, float) for number in numbers):
        raise TypeError("a course of training that is not of numbers")
    return state


def _require_intact(path: Path) -> None:
    """Check the checksums of the archive that `torch.save` writes; `torch.load` does not."""
    with path.open("rb") as file, ZipFile(file) as archive:
        require_stored(archive, file)
        if (damaged := archive.testzip()) is not None:
            raise BadZipFile(f"the checksum of {damaged} is wrong")
