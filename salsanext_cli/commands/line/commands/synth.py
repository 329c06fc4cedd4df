# SPDX-License-Identifier: MIT
"""`salsanext synth`."""

from pathlib import Path
from typing import Literal

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import option, option_group
from salsanext_cli.commands.line.output import console
from salsanext_cli.commands.line.output.progress import writing
from salsanext_cli.core.texts import counted


@option_group
class Scenes:
    """Numbers of the simulated scenes of `synth`."""

    train: int = option("Number of sequences for training.", default=8)
    valid: int = option("Number of sequences for validation.", default=2)
    test: int = option("Number of sequences for testing.", default=0)
    scans: int = option("Scans per sequence.", default=20)
    spacing: float = option("Distance between two scans, in metres.", default=3.0)
    sensor: Literal["hdl64", "random"] = option(
        "An HDL-64E, or a random sensor for each sequence.", default="hdl64"
    )
    seed: int = option("Random seed; equal seeds give equal files.", default=0)


def synth(
    out: Path = declarations.NEW_DATASET,
    *,
    scenes: Scenes,
    jobs: int = declarations.JOBS,
    cluster: str | None = declarations.CLUSTER,
    overwrite: bool = declarations.OVERWRITE,
    output: console.Output,
) -> None:
    """Simulate labelled scans of streets, in the layout of SemanticKITTI.

    Example: salsanext synth scenes/ --train 8 --valid 2 --scans 20
    """
    from salsanext_cli.commands.stages.synth import synthesise

    with writing("synth", output.quiet, unit="sequences") as on_progress:
        data_set = synthesise(
            out,
            train=scenes.train,
            valid=scenes.valid,
            test=scenes.test,
            scans=scenes.scans,
            spacing=scenes.spacing,
            sensor=scenes.sensor,
            seed=scenes.seed,
            jobs=jobs,
            cluster=cluster,
            overwrite=overwrite,
            progress=on_progress,
        )
    output.result(data_set.to_dict())
    points = sum(data_set.points.values())
    output.print(f"synth: {counted(data_set.scans, 'scan')}, {points:,} points → {out}")
