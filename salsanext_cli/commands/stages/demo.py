# SPDX-License-Identifier: MIT
"""Stage `demo`: the pipeline on a simulated drive, from its scans to the page of the run."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.commands.evaluation import Evaluation
from salsanext_cli.commands.stages.evaluate import evaluate
from salsanext_cli.commands.stages.export_ply import export_ply
from salsanext_cli.commands.stages.picture import picture
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.commands.stages.report import report
from salsanext_cli.commands.stages.synth import synthesise
from salsanext_cli.commands.stages.uncertainty import uncertainty
from salsanext_cli.core.uncertainty.error_features import knows_error
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.runs.loop.run import Failure, Progress, RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.folder_names import ERROR
from salsanext_cli.runs.results.output_paths import find_outputs
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.scans.scan_selection import ScanSelection

SEED = 2020  # The default weights were not trained on the scene of this seed.
SPACING_M = 12.0  # Distance between two scans


@dataclass(frozen=True, slots=True, kw_only=True)
class Demonstration:
    """Results of the demonstration."""

    evaluation: Evaluation  # Scores of the predictions
    pictures: tuple[Path, ...]  # PNG files
    page: Path  # Page of `report`
    failures: tuple[Failure, ...]  # Scans that a stage could not process


def demo(
    folder: Path,
    *,
    scans: int,
    samples: int,
    settings: NetworkSettings,
    options: RunOptions,
    progress_of_step: Callable[[str], AbstractContextManager[Progress | None]],
) -> Demonstration:
    """Simulate a drive, label its scans, and evaluate and show the labels.

    The simulated scans are in ``data/`` of the folder, the results in ``out/``.

    Parameters
    ----------
    folder : Path
        Folder to write to.
    scans : int
        Number of scans of the drive.
    samples : int
        Number of passes of Monte-Carlo dropout per scan.
    settings : NetworkSettings
        Network that predicts.
    options : RunOptions
        Workers, and treatment of existing results and failures, in every stage.
    progress_of_step : callable
        Opens a progress bar for a step of that name, and yields its callback, if there is one.

    Returns
    -------
    Demonstration
    """
    data = folder / "data"
    out = folder / "out"
    valid = ResultQuery(selection=ScanSelection(split="valid"))

    @contextmanager
    def step(name: str) -> Iterator[RunOptions]:
        with progress_of_step(name) as progress:
            yield replace(options, progress=progress)

    with step("synth") as step_options:
        synthesise(
            data,
            train=0,
            valid=1,
            scans=scans,
            spacing=SPACING_M,
            seed=SEED,
            overwrite=step_options.overwrite,
            progress=step_options.progress,
        )
    with step("predict") as step_options:
        # Whether the error is estimated depends on the settings too, not only on the card.
        extras = (ERROR,) if knows_error(settings.load()) else ()
        predicted = predict_scans(data, out, settings=settings, extras=extras, options=step_options)
    with step("uncertainty") as step_options:
        method = UncertaintyMethod(samples=samples)
        sampled = uncertainty(data, out, settings=settings, method=method, options=step_options)
    with step("export-ply") as step_options:
        exported = export_ply(out, colour="label", options=step_options)
    with step("picture") as step_options:
        pictured = picture(out, options=step_options)
    with step("eval") as step_options:
        evaluation = evaluate(out, query=valid, options=step_options)
    with step("report") as step_options:
        page = report(out, query=valid, options=step_options).page
    outcomes = (predicted, sampled, exported, pictured)
    return Demonstration(
        evaluation=evaluation,
        pictures=tuple(find_outputs(out, "pictures").values()),
        page=page,
        failures=tuple(failure for outcome in outcomes for failure in outcome.failures),
    )
