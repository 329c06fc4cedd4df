# SPDX-License-Identifier: MIT
"""Event files of a training for TensorBoard, which is an optional package."""

import math
import time
from io import BytesIO
from typing import Any

from salsanext_cli.core.optional_packages import import_package
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.training.fit import FinishedEpoch
from salsanext_cli.training.run_folder import Row, tensorboard_file

FORMAT = "brain.Event:2"  # Version of the format, which the first event of a file states


def require_tensorboard() -> None:
    """Raise `MissingDependency` if TensorBoard is not installed."""
    import_package("tensorboard")


def write_events(epoch: FinishedEpoch) -> None:
    """Write the row of an epoch as scalars, in an event file of its own.

    A training may be killed and resumed at any time, so no file stays open, and an epoch that is
    repeated replaces its file. TensorBoard reads all files of the folder as one run.
    """
    row = epoch.rows[-1]
    path = tensorboard_file(epoch.run, int(row["epoch"]))
    OwnedFolder(epoch.run).write(path, event_records(row, time.time()))


def event_records(row: Row, seconds: float) -> bytes:
    """Return the content of an event file.

    Parameters
    ----------
    row : Row
        Line of the log; its finite values become scalars.
    seconds : float
        Time of the events, in seconds since 1970.
    """
    require_tensorboard()
    Event = import_package("tensorboard.compat.proto.event_pb2").Event  # noqa: N806
    Summary = import_package("tensorboard.compat.proto.summary_pb2").Summary  # noqa: N806
    writer_of = import_package("tensorboard.summary.writer.record_writer").RecordWriter
    scalars = [
        Summary.Value(tag=key.replace("iou_", "iou/", 1), simple_value=value)
        for key, value in row.items()
        if key != "epoch" and math.isfinite(value)
    ]
    events: list[Any] = [
        Event(wall_time=seconds, file_version=FORMAT),
        Event(wall_time=seconds, step=int(row["epoch"]), summary=Summary(value=scalars)),
    ]
    content = BytesIO()
    writer = writer_of(content)
    for event in events:
        writer.write(event.SerializeToString())
    return content.getvalue()
