# SPDX-License-Identifier: MIT
"""Options that more than one command takes, about workers, existing results and output."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from functools import partial
from typing import TYPE_CHECKING, Annotated

from salsanext_cli.cli import console
from salsanext_cli.cli.option_groups import Default, Only, Without, option, option_group

if TYPE_CHECKING:
    from salsanext_cli.parallel.run import RunOptions
    from salsanext_cli.parallel.shards import Shard

OVERWRITE_HELP = "Replace existing results."

running_option = partial(option, "Running")
output_option = partial(option, "Output")


class Backend(StrEnum):
    """Kinds of workers."""

    loky = "loky"
    threading = "threading"
    dask = "dask"
    ray = "ray"


class OnError(StrEnum):
    """Behaviour when a scan fails."""

    skip = "skip"
    stop = "stop"


@option_group
class Output(console.Output):
    """Amount and form of what a command prints."""

    json: bool = output_option("Print one JSON object on stdout.", "--json", default=False)
    verbose: bool = output_option(
        "Print more messages on stderr.", "--verbose", "-v", default=False
    )
    quiet: bool = output_option("Print errors only.", "--quiet", "-q", default=False)


@option_group
class Local:
    """Way in which a command runs that uses this machine only."""

    jobs: int = running_option("Number of processes; -1: one per core.", "--jobs", "-j", default=1)
    overwrite: bool = running_option(OVERWRITE_HELP, "--overwrite", default=False)


Overwriting = Annotated[Local, Only({"overwrite"})]


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
        "Processes (loky), threads, or workers of a Dask or Ray cluster.", default=Backend.loky
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
    on_error: OnError = running_option(
        "Skip a scan that fails, or stop at the first.", default=OnError.skip
    )

    @contextmanager
    def over_scans(self, label: str, output: Output) -> Iterator[RunOptions]:
        """Build the options of a run that stages take; show its progress while the body runs."""
        from salsanext_cli.parallel.run import RunOptions

        options = RunOptions(
            self.jobs,
            self.on_error.value,
            self.overwrite,
            backend=self.backend.value,
            scheduler=self.scheduler,
            shard=self._shard(output),
        )
        with console.batch(label, output, options) as with_progress:
            yield with_progress

    def _shard(self, output: Output) -> Shard:
        from salsanext_cli.parallel.shards import Shard

        if self.shard is not None:
            return Shard.parse(self.shard)
        of_array = Shard.of_slurm(os.environ)
        if of_array is None:
            return Shard()
        output.say(f"shard {of_array} of the scans, as this is a task of a Slurm array")
        return of_array


RunningUnsharded = Annotated[Running, Without({"shard"}), Default(shard="1/1")]
"""For results over all scans, which several runs cannot share."""
