# SPDX-License-Identifier: MIT
"""Whole pipeline on a synthetic drive: generate, predict, sample, evaluate, export, draw."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

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
"""Seed of the drive: another than that of the default weights, which do not know this street."""
SPACING_M = 12.0

StepProgress = Callable[[str], AbstractContextManager[Progress | None]]
"""Function from the name of a step to a context that gives its progress callback."""


@dataclass(frozen=True, slots=True)
class Demonstration:
    """Results of the demonstration.

    Attributes
    ----------
    data, out : Path
        Folders of the synthetic data set and of the results.
    evaluation : Evaluation
        Scores of the predictions.
    pictures : tuple of Path
        PNG files.
    failures : tuple of Failure
        Scans that a stage could not process.
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
    bars: StepProgress,
) -> Demonstration:
    """Run every stage on a synthetic drive; existing results are kept unless overwriting.

    Parameters
    ----------
    folder : Path
        Folder of ``data/`` and ``out/``.
    scans : int
        Number of scans of the drive.
    samples : int
        Monte-Carlo passes per scan.
    network : NetworkSettings
        Weights and device.
    options : RunOptions
        Jobs, errors and overwriting.
    bars : callable
        Gives the progress of a step, by its name.

    Raises
    ------
    SalsanextError
        If a stage cannot be run.
    """
    data, out = folder / "data", folder / "out"
    estimator = Estimator(samples=samples)
    # `labels.yaml` is written last.
    complete = (data / "labels.yaml").exists()
    if options.overwrite or not complete or len(find_scans(data)) != scans:
        with bars("synth") as progress:
            synthesise(
                data,
                train=0,
                valid=1,
                scans=scans,
                seed=SEED,
                spacing=SPACING_M,
                overwrite=options.overwrite or not complete,
                progress=progress,
            )

    def run(step: str, stage: Callable[[RunOptions], Outcome]) -> tuple[Failure, ...]:
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
