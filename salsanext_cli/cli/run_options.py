# SPDX-License-Identifier: MIT
"""Options that more than one command takes, about workers, existing results and output."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from salsanext_cli.cli import console
from salsanext_cli.cli.option_groups import Default, OptionGroup, Without
from salsanext_cli.errors import UsageError

if TYPE_CHECKING:
    from salsanext_cli.parallel.run import RunOptions
    from salsanext_cli.parallel.shards import Shard

running_option = partial(typer.Option, rich_help_panel="Running")
output_option = partial(typer.Option, rich_help_panel="Output")

Overwrite = Annotated[bool, running_option("--overwrite", help="Replace existing results.")]
Jobs = Annotated[int, running_option("--jobs", "-j", help="Number of processes; -1: one per core.")]
BatchSize = Annotated[
    str,
    running_option(
        help="Scans computed together, halved when memory runs out; auto: 1 on a CPU, on a GPU as "
        "many as keep it busy."
    ),
]


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


@dataclass(frozen=True, slots=True)
class Output(console.Output, OptionGroup):
    """Amount and form of what a command prints."""

    json: Annotated[bool, output_option("--json", help="Print one JSON object on stdout.")] = False
    verbose: Annotated[
        bool, output_option("--verbose", "-v", help="Print more messages on stderr.")
    ] = False
    quiet: Annotated[bool, output_option("--quiet", "-q", help="Print errors only.")] = False


@dataclass(frozen=True, slots=True)
class Running(OptionGroup):
    """Way in which a command goes through scans."""

    jobs: Annotated[
        int | None,
        running_option(
            "--jobs",
            "-j",
            help="Number of workers; -1: one per core.",
            show_default="1; all workers of a cluster",
        ),
    ] = None
    backend: Annotated[
        Backend,
        running_option(help="Processes (loky), threads, or workers of a Dask or Ray cluster."),
    ] = Backend.loky
    scheduler: Annotated[
        str | None,
        running_option(
            metavar="ADDRESS",
            help="Address of a running Dask or Ray cluster.",
            show_default="a new cluster on this machine",
        ),
    ] = None
    shard: Annotated[
        str | None,
        running_option(
            metavar="I/N",
            help="Only share I of N shares of the scans, from 1/N to N/N.",
            show_default="the share of this Slurm array task, else 1/1",
        ),
    ] = None
    overwrite: Overwrite = False
    on_error: Annotated[
        OnError, running_option(help="Skip a scan that fails, or stop at the first.")
    ] = OnError.skip

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


def batch_size(text: str) -> int | None:
    """Return the number of scans computed together, None for what suits the device."""
    if text == "auto":
        return None
    if not re.fullmatch(r"\d{1,9}", text, re.ASCII):
        raise UsageError("--batch", repr(text), "auto, or a number of scans")
    return int(text)
