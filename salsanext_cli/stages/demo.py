# SPDX-License-Identifier: MIT
"""The whole pipeline on a synthetic drive: generate, predict, sample, evaluate, export, draw."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.parallel.run import Failure, Outcome, Progress, RunOptions
from salsanext_cli.report.scan_pictures import draw_scan
from salsanext_cli.stages.evaluate import Evaluation, evaluate
from salsanext_cli.stages.export_ply import export_ply
from salsanext_cli.stages.predict import predict_scans
from salsanext_cli.stages.synth import synthesise
from salsanext_cli.stages.uncertainty import uncertainty
from salsanext_cli.storage.layout import find_scans
from salsanext_cli.storage.predictions import predicted_scans, provenance
from salsanext_cli.storage.selection import ScanSelection
from salsanext_cli.uncertainty.settings import Estimator

SEED = 2020
"""Not the seed that the default weights were trained with: these streets are new to them."""
SPACING = 12.0

Bars = Callable[[str], AbstractContextManager[Progress | None]]
"""Gives each step, by name, something to report its progress to."""


@dataclass(frozen=True, slots=True)
class Demonstration:
    """What was made, and where it is.

    Attributes
    ----------
    data, out : Path
        The synthetic data set, and the results of the stages.
    evaluation : Evaluation
        Scores of the predictions.
    pictures : tuple of Path
        PNG files.
    failures : tuple of Failure
        Scans that a stage could not work on.
    """

    data: Path
    out: Path
    evaluation: Evaluation
    pictures: tuple[Path, ...]
    failures: tuple[Failure, ...]


def demo(
    folder: Path,
    *,
    scans: int,
    samples: int,
    network: NetworkSettings,
    options: RunOptions,
    bars: Bars,
) -> Demonstration:
    """Run every stage on a synthetic drive; what exists already is kept unless overwriting.

    Parameters
    ----------
    folder : Path
        Gets ``data/`` and ``out/``.
    scans : int
        Length of the drive.
    samples : int
        Monte-Carlo passes per scan.
    network : NetworkChoice
        Weights and device.
    options : BatchOptions
        Jobs, errors and overwriting.
    bars : callable
        Called with the name of each step.

    Raises
    ------
    SalsanextError
        If a stage cannot be run.
    """
    data, out = folder / "data", folder / "out"
    estimator = Estimator(samples=samples)
    _make_data(data, scans, options.overwrite, bars)

    def run(step: str, stage: Callable[[RunOptions], Outcome[Any]]) -> tuple[Failure, ...]:
        with bars(step) as progress:
            return stage(replace(options, progress=progress)).failures

    failures = (
        *run("predict", lambda o: predict_scans(data, out, network=network, options=o)),
        *run(
            "uncertainty",
            lambda o: uncertainty(data, out, network=network, estimator=estimator, options=o),
        ),
        *run("export-ply", lambda o: export_ply(out, colour="label", options=o)),
    )
    selection = ScanSelection(split="valid")
    files, space = predicted_scans(out, selection)
    with bars("eval") as progress:
        evaluation = evaluate(
            files,
            out,
            space,
            replace(options, progress=progress),
            settings=provenance(out, selection),
        )
    sensor = network.load().sensor
    pictures = draw_scan(files[len(files) // 2], out, space, sensor, out / "pictures")
    return Demonstration(data, out, evaluation, pictures, failures)


def _make_data(data: Path, scans: int, overwrite: bool, bars: Bars) -> None:
    """Generate the drive unless it is there; `labels.yaml` is written last."""
    complete = (data / "labels.yaml").exists()
    if complete and not overwrite and len(find_scans(data)) == scans:
        return
    with bars("synth") as progress:
        synthesise(
            data,
            train=0,
            valid=1,
            scans=scans,
            seed=SEED,
            spacing=SPACING,
            overwrite=overwrite or not complete,
            progress=progress,
        )
