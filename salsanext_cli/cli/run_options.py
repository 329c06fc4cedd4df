# SPDX-License-Identifier: MIT
"""The options that say who works on the scans: how many, where, and on which share of them."""

from __future__ import annotations

import os
import re
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from salsanext_cli.cli import options
from salsanext_cli.errors import UsageError

if TYPE_CHECKING:
    from salsanext_cli.cli.console import Output
    from salsanext_cli.parallel.run import RunOptions
    from salsanext_cli.parallel.shards import Shard


class Backend(StrEnum):
    """What works side by side."""

    loky = "loky"
    threading = "threading"
    dask = "dask"
    ray = "ray"


Jobs = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        "-j",
        help="Workers side by side; -1: all cores.",
        show_default="1, of a cluster all",
        rich_help_panel=options.RUNNING,
    ),
]
BackendOption = Annotated[
    Backend,
    typer.Option(
        "--backend",
        help="Processes (loky), threads, or the workers of a Dask or Ray cluster.",
        rich_help_panel=options.RUNNING,
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Of a running Dask or Ray cluster.",
        show_default="a new one here",
        rich_help_panel=options.RUNNING,
    ),
]
Share = Annotated[
    str | None,
    typer.Option(
        "--shard",
        metavar="I/N",
        help="Only this share of the scans, from 1/N to N/N.",
        show_default="that of the Slurm array, else all",
        rich_help_panel=options.RUNNING,
    ),
]
Batch = Annotated[
    str,
    typer.Option(
        help="Scans computed together, halved when memory runs out; auto: 1 on a CPU, on a GPU "
        "what keeps it busy.",
        rich_help_panel=options.RUNNING,
    ),
]


def batch_size(text: str) -> int | None:
    """Return how many scans are computed together, None for what suits the device."""
    if text == "auto":
        return None
    if not re.fullmatch(r"\d{1,9}", text, re.ASCII):
        raise UsageError("--batch", repr(text), "auto, or a number of scans")
    return int(text)


def gather(
    jobs: int | None,
    backend: Backend,
    scheduler: str | None,
    on_error: options.OnError,
    overwrite: bool = False,
    shard: Shard | None = None,
) -> RunOptions:
    """Gather how scans are gone through."""
    from salsanext_cli.parallel.run import RunOptions
    from salsanext_cli.parallel.shards import Shard

    return RunOptions(
        jobs,
        on_error.value,
        overwrite,
        backend=backend.value,
        scheduler=scheduler,
        shard=shard or Shard(),
    )


def share(text: str | None, output: Output) -> Shard:
    """Return the shard that was asked for, else that of a task of a Slurm array, and say so."""
    from salsanext_cli.parallel.shards import Shard

    if text is not None:
        return Shard.parse(text)
    of_array = Shard.of_slurm(os.environ)
    if of_array is None:
        return Shard()
    output.say(f"shard {of_array} of the scans, as this is a task of a Slurm array")
    return of_array
