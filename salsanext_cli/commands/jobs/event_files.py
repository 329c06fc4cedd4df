# SPDX-License-Identifier: MIT
"""Event files of a training for TensorBoard, which is an optional package."""

import math

from salsanext_cli.core.optional_packages import import_package
from salsanext_cli.training.fit import FinishedEpoch
from salsanext_cli.training.run_folder import EVENTS


def require_tensorboard() -> None:
    """Raise `MissingDependency` if TensorBoard is not installed."""
    import_package("tensorboard")


def write_events(epoch: FinishedEpoch) -> None:
    """Write the row of an epoch as scalars, in an event file of its own.

    A training may be killed and resumed at any time, so no file stays open. TensorBoard reads all
    files of the folder as one run.
    """
    require_tensorboard()
    writer_of = import_package("torch.utils.tensorboard").SummaryWriter
    row = epoch.rows[-1]
    number = int(row["epoch"])
    with writer_of(str(epoch.run / EVENTS), filename_suffix=f".{number}") as writer:
        for key, value in row.items():
            if key != "epoch" and math.isfinite(value):
                writer.add_scalar(key.replace("iou_", "iou/", 1), value, number)
