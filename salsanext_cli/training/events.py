# SPDX-License-Identifier: MIT
"""The course of a training for TensorBoard, where that is installed."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.training.log import Row

EVENTS = "tensorboard"
"""Folder of a run for TensorBoard's files."""

log = logging.getLogger(__name__)


class Events:
    """Writes nothing: what there is without TensorBoard."""

    def add(self, row: Row, picture: npt.NDArray[np.uint8]) -> None:
        """Take note of a finished epoch and of its picture, (H, W, 3)."""


class TensorBoardEvents(Events):
    """Writes an epoch's figures as scalars, classes below ``iou/``, and its picture as image.

    Parameters
    ----------
    writer : torch.utils.tensorboard.SummaryWriter
    """

    def __init__(self, writer: Any) -> None:
        self.writer = writer

    def add(self, row: Row, picture: npt.NDArray[np.uint8]) -> None:
        """Write an epoch; what was not measured is left out."""
        epoch = int(row["epoch"])
        for key, value in row.items():
            if key != "epoch" and value == value:
                self.writer.add_scalar(key.replace("iou_", "iou/", 1), value, epoch)
        self.writer.add_image("sample", picture, epoch, dataformats="HWC")
        self.writer.flush()


@contextmanager
def events_in(folder: Path, *, wanted: bool = True) -> Iterator[Events]:
    """Give what writes events into a folder while the body runs, if TensorBoard is installed.

    Parameters
    ----------
    folder : Path
        Gets a file for every time that training goes on.
    wanted : bool
        Whether to write; a worker that does not lead does not.
    """
    if not wanted or find_spec("tensorboard") is None:
        if wanted:
            log.info("TensorBoard is not installed, so nothing is written for it")
        yield Events()
        return
    from torch.utils.tensorboard import SummaryWriter  # an optional dependency

    with SummaryWriter(str(folder)) as writer:
        yield TensorBoardEvents(writer)
