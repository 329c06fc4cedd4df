# SPDX-License-Identifier: MIT
"""`salsanext predict`."""

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import option, option_group, running_option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.next_command import command_on_labels
from salsanext_cli.commands.line.output.printed_plan import print_plan
from salsanext_cli.commands.line.output.progress import over_scans
from salsanext_cli.commands.line.values.jobs_option import MeasuredRunOptions
from salsanext_cli.commands.line.values.scans_and_out import scans_and_out
from salsanext_cli.commands.line.values.typed_values import typed_position, typed_share
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.notices import demote_result_notices
from salsanext_cli.core.texts import counted, percentage
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.sensor_request import AUTO

if TYPE_CHECKING:
    from salsanext_cli.commands.stages.predict import PredictOutcome
    from salsanext_cli.core.records import Origin

MANY_SCANS = 100  # Fewer take so little time that no faster option is named
WAIT_S = 1.0  # Time between two checks whether another run has ended


@option_group
class Extras:
    """Results that `predict` writes besides the labels, and the rejection of labels."""

    error: bool = option("Also write the estimated probability of a wrong label.", default=False)
    reject: str | None = option(
        "Leave a point unlabelled if its probability of error exceeds this value, or `risk` for "
        "the threshold chosen by `tune risk`.",
        metavar="ERROR|risk",
    )
    objects: bool = option(
        "Number vehicles, people and riders in the upper 16 bits of the labels, and write their "
        "bounding boxes.",
        default=False,
    )
    fuse: bool = option(
        "Also write labels fused over each sequence into OUT/fused (see `fuse`).", default=False
    )
    probabilities: bool = option(
        "Also write the class probabilities of every point.", default=False
    )
    pixel_labels: bool = option("Also write the label of every pixel.", default=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the further results, as `predict_scans` takes them."""
        # A fusion reads the probabilities of single scans, and their votes where there are none.
        is_requested = {
            "pixel_labels": self.pixel_labels,
            "probabilities": self.probabilities,
            "uncertainty/error": self.error,
            "votes": self.fuse and not self.probabilities,
            "objects": self.objects,
        }
        return tuple(name for name, requested in is_requested.items() if requested)

    @property
    def threshold(self) -> float | Literal["risk"] | None:
        """Largest probability of error of an accepted point, as `predict_scans` takes it."""
        if self.reject == "risk":
            return "risk"
        return typed_share("--reject", self.reject, word="risk")

    def require_fusable(self, source: Path | list[Path], out: Path, running: RunOptions) -> None:
        """Refuse scans and options that cannot be fused."""
        from salsanext_cli.commands.stages.fuse import require_fusable

        conflicting: list[str] = []
        if self.objects:
            conflicting.append("--objects")
        if self.reject is not None:
            conflicting.append("--reject")
        if conflicting:
            problem = f"was given with {' and '.join(conflicting)}"
            hint = "run `predict` a second time without --fuse"
            raise UsageError("--fuse", problem, "--fuse alone", hint)
        require_fusable(source, out, running)


def predict(
    context: typer.Context,
    scans: Path | None = declarations.SEVERAL_SCANS,
    out: Path = declarations.OUT,
    *,
    extras: Extras,
    dataset: Path | None = declarations.DATASET,
    selection: ScanSelection,
    topic: str | None = declarations.TOPIC,
    classes: str | None = declarations.CLASSES,
    settings: declarations.Network,
    origin: str | None = declarations.ORIGIN,
    knn: KnnParameters,
    batch: int | None = running_option(
        "Scans computed together, halved if memory runs out.",
        show_default="1 on a CPU, several on a GPU",
    ),
    running: MeasuredRunOptions,
    dry_run: bool = declarations.DRY_RUN,
    strict: bool = declarations.STRICT,
    output: console.Output,
) -> None:
    """Predict the class of every point of every scan.

    Example: salsanext predict seq/velodyne out/
    """
    from salsanext_cli.commands.stages.predict import (
        plan_prediction,
        predict_range_images,
        predict_scans,
    )
    from salsanext_cli.runs.fit.range_images import projected_sensor
    from salsanext_cli.runs.results.folder_names import FUSED

    places = scans_and_out(context, scans, out, dataset, topic)
    source = places.scans
    out = places.out
    settings = replace(settings, classes=classes)
    position = typed_position("--origin", origin)
    range_images: Path | None = None  # Output of `project`, if that is the source
    if isinstance(source, Path) and projected_sensor(source) is not None:
        range_images = source
        _refuse_options_of_points(extras, knn, batch, position)
    elif extras.fuse:
        extras.require_fusable(source, out, running)
    if dry_run:
        if range_images is not None:
            raise UsageError("--dry-run", "plans no range images", "scans as the source")
        with demote_result_notices():
            plan = plan_prediction(
                source,
                out,
                settings=settings,
                knn=knn,
                extras=extras.names,
                reject=extras.threshold,
                origin=position,
                selection=selection,
                options=running,
            )
        print_plan("predict", plan, out, output)
        return
    with over_scans("predict", running, output.quiet) as options:
        if range_images is not None:
            prediction = predict_range_images(
                range_images, out, settings=settings, selection=selection, options=options
            )
        else:
            prediction = predict_scans(
                source,
                out,
                settings=settings,
                knn=knn,
                extras=extras.names,
                reject=extras.threshold,
                batch=batch,
                origin=position,
                selection=selection,
                options=options,
            )
    outcome = prediction
    folder_of_labels = out
    if extras.fuse and prediction.has_results:
        folder_of_labels = out / FUSED
        outcome = _with_fusion(prediction, out, folder_of_labels, selection, running, output)
    following = command_on_labels(outcome, folder_of_labels, selection.split)
    numbers = _numbers(outcome, extras.threshold, _advice(settings, outcome, out))
    summary.print_summary_and_exit(
        "predict", outcome, out, output, following=following, numbers=numbers, strict=strict
    )


def _numbers(
    outcome: "PredictOutcome", threshold: float | str | None, advice: str
) -> summary.StageNumbers:
    """Return the numbers of rejected points, and a line of advice unless it is empty.

    `threshold`: largest probability of error of an accepted point, or "risk".
    """
    data: dict[str, object] = {}
    lines: list[str] = []
    if outcome.rejected_points is not None:
        data["rejected_points"] = outcome.rejected_points
        if outcome.summary:
            data["rejected_share"] = round(outcome.summary.counts.rejected_share, 4)
        lines.append(_rejection_line(outcome, outcome.rejected_points, threshold))
    if advice:
        lines.append(advice)
    return summary.StageNumbers(data=data, lines=lines)


def _rejection_line(outcome: "PredictOutcome", rejected: int, threshold: float | str | None) -> str:
    """Return the line about rejected points; `threshold` as of `_numbers`."""
    share = ""
    if outcome.summary and outcome.summary.counts.judged_points:
        share = f" ({percentage(outcome.summary.counts.rejected_share)} of the points with a label)"
    reason = "above the threshold of `tune risk`"
    if threshold != "risk":
        reason = f"probability of error above {threshold:g}"
    uncounted = f"; {outcome.skipped} done already not counted" if outcome.skipped else ""
    return f"{counted(rejected, 'point')}{share} rejected: {reason}{uncounted}"


def _advice(settings: NetworkSettings, outcome: "PredictOutcome", out: Path) -> str:
    """Return a line about a faster option for a long run; an empty text if there is none."""
    from salsanext_cli.core.engines.device import bfloat16_instructions, processor_flags
    from salsanext_cli.core.engines.registry import computes_int8
    from salsanext_cli.runs.results.manifest import Manifest

    if settings.precision != AUTO or outcome.done <= MANY_SCANS or not outcome.has_int8_ranges:
        return ""
    recorded = Manifest(out).settings("predict")
    if recorded is None or not computes_int8(recorded.engine):
        return ""
    if recorded.guarantee is not None:  # It covers the labels of this precision only.
        return ""
    if bfloat16_instructions() or "avx2" not in processor_flags():
        return ""
    return "faster: --precision int8 takes about 60 % of the time; about 1 % of the labels differ"


def _with_fusion(
    prediction: "PredictOutcome",
    out: Path,
    target: Path,
    selection: ScanSelection,
    running: RunOptions,
    output: console.Output,
) -> "PredictOutcome":
    """Fuse the labels of a prediction into a folder; return the outcome of both steps."""
    from salsanext_cli.commands.stages.fuse import fuse_results

    _wait_for_other_runs(out, output)
    with over_scans("fuse", running, output.quiet) as options:
        fused = fuse_results(out, target, query=ResultQuery(selection=selection), options=options)
    output.print(f"fuse: {counted(fused.done, 'scan')} → {target}")
    if prediction.summary is not None and fused.summary is not None:
        prediction.summary.findings.add_others(fused.summary.findings)
    failures = dict.fromkeys((*prediction.failures, *fused.failures))
    return replace(prediction, failures=tuple(failures))


def _wait_for_other_runs(out: Path, output: console.Output) -> None:
    """Wait until no other run predicts into a folder."""
    from salsanext_cli.runs.results.owned_folder import OwnedFolder

    predictions = OwnedFolder(out, "predict")
    if not predictions.is_shared():
        return
    output.print("fuse: waiting for another run of `predict` in this folder")
    while predictions.is_shared():
        time.sleep(WAIT_S)


def _refuse_options_of_points(
    extras: Extras, knn: KnnParameters, batch: int | None, origin: "Origin | None"
) -> None:
    """Refuse options that need scans, where the source is range images of `project`."""
    for name in ("probabilities", "error", "fuse", "objects", "reject"):
        if getattr(extras, name):
            problem = "range images do not contain the points"
            raise UsageError(f"--{name}", problem, "scans as the source")
    if knn != KnnParameters():
        hint = "give the options to `knn-refine`"
        raise UsageError("--knn-*", "`predict` does not refine range images", hint=hint)
    if origin is not None:
        problem = "range images are seen from one position already"
        raise UsageError("--origin", problem, "scans as the source")
    if batch is not None:
        raise UsageError("--batch", "range images are computed one by one", "scans as the source")
