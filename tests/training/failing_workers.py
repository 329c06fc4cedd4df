# SPDX-License-Identifier: MIT
"""Workers that fail; `forked_workers` starts them as torchrun does."""

import logging
import sys
import time
from pathlib import Path

import torch

from salsanext_cli.core.errors import TrainingError
from salsanext_cli.training import failure_watch
from salsanext_cli.training.distributed import process_group


def fail_alike(_: Path) -> None:
    """Raise the same error in all workers, and print it as the command line does."""
    try:
        with process_group("cpu"):
            raise TrainingError("data", "is empty")
    except TrainingError as error:
        if not error.reported_elsewhere:
            sys.stderr.write(f"{error}\n")


def fail(_: Path) -> None:
    """Let the last worker fail while the others are busy endlessly."""
    logging.basicConfig(format="%(message)s")
    failure_watch.LEAVING_S = 0.1  # so that the others stay a second instead of five
    with process_group("cpu") as (group, _):
        group.sum(torch.ones(1))
        if group.rank == 0:
            group.on_main(lambda: time.sleep(1000))
        elif group.rank == 1:
            group.sum(torch.ones(1))
        raise ZeroDivisionError("out of luck")
