# SPDX-License-Identifier: MIT
"""Options that more than one command takes, about workers and existing results."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal

from salsanext_cli.cli.console import Output
from salsanext_cli.cli.option_groups import Default, Without, option, option_group
from salsanext_cli.cli.progress import progress

if TYPE_CHECKING:
    from salsanext_cli.parallel.run import RunOptions

OVERWRITE_HELP = "Replace existing results."

running_option = partial(option, "Running")
Backend = Literal["loky", "threading", "dask", "ray"]


@option_group
class Local:
    """Way in which a command runs that uses this machine only."""

    jobs: int = running_option("Number of processes; -1: one per core.", "--jobs", "-j", default=1)
    overwrite: bool = running_option(OVERWRITE_HELP, "--overwrite", default=False)


Overwriting = Annotated[Local, Without({"jobs"})]


@option_group
class Running:
    """Way in which a command goes through scans."""

    jobs: int | None = running_option(
        "Number of workers; -1: one per core.",
        "--jobs",
        "-j",
        show_default="1; all workers of a cluster",
    )
    backend: Backend = running_option(
        "Processes (loky), threads, or workers of a Dask or Ray cluster.", default="loky"
    )
    scheduler: str | None = running_option(
        "Address of a running Dask or Ray cluster.",
        metavar="ADDRESS",
        show_default="a new cluster on this machine",
    )
    shard: str | None = running_option(
        "Only share I of N shares of the scans, from 1/N to N/N.",
        metavar="I/N",
        show_default="the share of this Slurm array task, else 1/1",
    )
    overwrite: bool = running_option(OVERWRITE_HELP, "--overwrite", default=False)
    on_error: Literal["skip", "stop"] = running_option(
        "Skip a scan that fails, or stop at the first.", default="skip"
    )

    @contextmanager
    def over_scans(self, label: str, output: Output) -> Iterator[RunOptions]:
        """Build the options of a run that stages take; show its progress while the body runs."""
        from salsanext_cli.parallel.run import RunOptions
        from salsanext_cli.parallel.shards import Shard

        if self.shard is not None:
            shard = Shard.parse(self.shard)
        elif (of_array := Shard.of_slurm(os.environ)) is not None:
            shard = of_array
            output.say(f"shard {shard} of the scans, as this is a task of a Slurm array")
        else:
            shard = Shard()
        with progress(label, output.quiet) as bar:
            given = (self.jobs, self.on_error, self.overwrite, bar, self.backend, self.scheduler)
            yield RunOptions(*given, shard)


@option_group
class Checked(Running):
    """Way in which a command goes through scans that are checked."""

    strict: bool = running_option(
        "End with status 1 if a scan or its labels are doubtful.", "--strict", default=False
    )


@option_group
class Training(Local):
    """Way in which a command trains on scans that are checked."""

    strict: bool = running_option("Do not train if a scan is doubtful.", "--strict", default=False)


RunningUnsharded = Annotated[Running, Without({"shard"}), Default(shard="1/1")]
CheckedUnsharded = Annotated[Checked, Without({"shard"}), Default(shard="1/1")]
"""For results over all scans, which several runs cannot share."""
