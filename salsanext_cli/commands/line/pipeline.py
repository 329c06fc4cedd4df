# SPDX-License-Identifier: MIT
"""Commands that label scans: project, predict, knn-refine, uncertainty."""

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from salsanext_cli.commands.line import arguments, console, summary
from salsanext_cli.commands.line.console import over_scans
from salsanext_cli.commands.line.expansion import Without
from salsanext_cli.commands.line.option_fields import option, option_group, running_option
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.texts import counted
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.query import ResultQuery, named_label_space
from salsanext_cli.runs.results.scan_selection import ScanSelection
from salsanext_cli.runs.sensor_request import AUTO, with_names

if TYPE_CHECKING:
    from salsanext_cli.runs.loop.run import Outcome

MANY_SCANS = 100  # Fewer take so little time that no faster option is named
WAIT_S = 1.0  # Time between two checks whether another run has ended


def project(
    context: typer.Context,
    scans: Path | None = arguments.SEVERAL_SCANS,
    out: Path = arguments.OUT,
    *,
    dataset: Path | None = arguments.DATASET,
    selection: ScanSelection,
    topic: str | None = arguments.TOPIC,
    settings: Annotated[arguments.Network, Without({"device", "precision", "engine", "intensity"})],
    running: RunOptions,
    strict: bool = arguments.STRICT,
    output: console.Output,
) -> None:
    """Project scans onto range images, for `predict` or your own programs.

    Example: salsanext project seq/velodyne out/
    """
    from salsanext_cli.commands.stages.project import project_scans

    source, out = arguments.sources(context, scans, out, dataset, topic)
    sensor = settings.named_sensor() or settings.trained_sensor()
    with over_scans("project", running, output.quiet) as run:
        outcome = project_scans(
            source,
            out,
            sensor=sensor,
            fit=settings.fits_view,
            fit_mounting=settings.fits_mounting,
            selection=selection,
            options=run,
        )
    named = None if settings.sensor == AUTO else settings.sensor
    given = {"--weights": settings.weights, "--sensor": named}
    more = [word for name, value in given.items() if value for word in (name, str(value))]
    summary.finish("project", outcome, out, output, *more, strict=strict)


@option_group
class Extras:
    """Results that `predict` writes besides the labels, and the rejection of labels."""

    error: bool = option("Also write the probability that each label is wrong.", default=False)
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
        wanted = {
            "pixel_labels": self.pixel_labels,
            "probabilities": self.probabilities,
            "uncertainty/error": self.error,
            "votes": self.fuse and not self.probabilities,
            "objects": self.objects,
        }
        return tuple(name for name in wanted if wanted[name])

    @property
    def threshold(self) -> float | Literal["risk"] | None:
        """Largest probability of error of an accepted point, as `predict_scans` takes it."""
        if self.reject == "risk":
            return "risk"
        return arguments.share("--reject", self.reject, word="risk")

    def require_fusable(self, source: Path | list[Path], out: Path, running: RunOptions) -> None:
        """Refuse scans and options that cannot be fused."""
        from salsanext_cli.commands.stages.fuse import require_fusable

        is_given = {"--objects": self.objects, "--reject": self.reject is not None}
        if given := [name for name in is_given if is_given[name]]:
            hint = "run `predict` a second time without --fuse"
            problem = f"was given with {' and '.join(given)}"
            raise UsageError("--fuse", problem, "--fuse alone", hint)
        require_fusable(source, out, running)


def predict(
    context: typer.Context,
    scans: Path | None = arguments.SEVERAL_SCANS,
    out: Path = arguments.OUT,
    *,
    extras: Extras,
    dataset: Path | None = arguments.DATASET,
    selection: ScanSelection,
    topic: str | None = arguments.TOPIC,
    classes: str | None = arguments.CLASSES,
    settings: arguments.Network,
    knn: KnnParameters,
    batch: int | None = running_option(
        "Scans computed together, halved if memory runs out.",
        show_default="1 on a CPU, several on a GPU",
    ),
    running: RunOptions,
    strict: bool = arguments.STRICT,
    output: console.Output,
) -> None:
    """Predict the class of every point of every scan.

    Example: salsanext predict seq/velodyne out/
    """
    from salsanext_cli.commands.stages.predict import predict_range_images, predict_scans
    from salsanext_cli.runs.fit.range_images import projected_sensor

    source, out = arguments.sources(context, scans, out, dataset, topic)
    if extras.fuse:
        extras.require_fusable(source, out, running)
    settings = replace(settings, classes=named_label_space(classes))
    with over_scans("predict", running, output.quiet) as run:
        if not isinstance(source, Path) or projected_sensor(source) is None:
            outcome: Outcome = predict_scans(
                *(source, out),
                settings=settings,
                knn=knn,
                extras=extras.names,
                reject=extras.threshold,
                batch=batch,
                selection=selection,
                options=run,
            )
        else:
            _refuse_options_of_points(extras, knn, batch)
            outcome = predict_range_images(
                source, out, settings=settings, selection=selection, options=run
            )
    results, split = out, selection.split
    if extras.fuse and outcome.done + outcome.skipped:
        outcome, results = _then_fused(outcome, out, selection, running, output)
    summary.finish(
        *("predict", outcome, out, output),
        split=split,
        strict=strict,
        results=results,
        limit=extras.threshold,
        advice=_advice(settings, outcome, out),
    )


def _advice(settings: NetworkSettings, outcome: "Outcome", out: Path) -> str:
    """Return a line about a faster option for a long run; an empty text if there is none."""
    from salsanext_cli.core.engines.device import bfloat16_instructions, flags
    from salsanext_cli.core.engines.registry import computes_int8
    from salsanext_cli.runs.results.manifest import Manifest

    if settings.precision != AUTO or outcome.done <= MANY_SCANS:
        return ""
    recorded, is_slow = Manifest(out).settings("predict"), not bfloat16_instructions()
    if not (recorded and computes_int8(recorded.engine) and is_slow and "avx2" in flags()):
        return ""
    return "faster: --precision int8 takes about 60 % of the time; about 1 % of the labels differ"


def _then_fused(
    outcome: "Outcome",
    out: Path,
    selection: ScanSelection,
    running: RunOptions,
    output: console.Output,
) -> "tuple[Outcome, Path]":
    """Fuse the predictions; return the outcome of both steps and the folder of the fused labels."""
    from salsanext_cli.commands.stages.fuse import FUSED, fuse_results
    from salsanext_cli.runs.results.owned_folder import OwnedFolder

    if (predicted := OwnedFolder(out, "predict")).is_shared():
        output.print("fuse: waiting for another run of `predict` in this folder")
        while predicted.is_shared():
            time.sleep(WAIT_S)
    with over_scans("fuse", running, output.quiet) as run:
        fused = fuse_results(out, query=ResultQuery(selection=selection), options=run)
    output.print(f"fuse: {counted(fused.done, 'scan')} → {out / FUSED}")
    failures = dict.fromkeys((*outcome.failures, *fused.failures))
    if outcome.summary is not None and fused.summary is not None:
        outcome.summary.findings.update(fused.summary.findings)
    return replace(outcome, failures=tuple(failures)), out / FUSED


def _refuse_options_of_points(extras: Extras, knn: KnnParameters, batch: int | None) -> None:
    """Refuse options that need scans, where the source is range images of `project`."""
    for name in ("probabilities", "error", "fuse", "objects", "reject"):
        if getattr(extras, name):
            problem = "range images do not contain the points"
            raise UsageError(f"--{name}", problem, "scans as the source")
    if knn != KnnParameters():
        hint = "give the options to `knn-refine`"
        raise UsageError("--knn-*", "`predict` does not refine range images", hint=hint)
    if batch is not None:
        raise UsageError("--batch", "range images are computed one by one", "scans as the source")


def knn_refine(
    out: Path = arguments.RESULTS,
    *,
    dataset: Path | None = arguments.DATASET_OF_RESULTS,
    selection: ScanSelection,
    label_space: str | None = arguments.LABEL_SPACE,
    sensor: str | None = arguments.sensor_option(
        show_default="the sensor of the earlier commands, else hdl64"
    ),
    columns: str | None = arguments.columns_option(
        show_default="columns of the earlier commands, else x,y,z,intensity"
    ),
    knn: KnnParameters,
    running: RunOptions,
    strict: bool = arguments.STRICT,
    output: console.Output,
) -> None:
    """Assign labels of pixels to points by a vote of the nearest neighbours.

    Example: salsanext knn-refine out/
    """
    from salsanext_cli.commands.stages.knn_refine import knn_refine_scans
    from salsanext_cli.runs.results.manifest import Manifest

    named = arguments.sensor(sensor)
    if columns is not None:
        named = with_names(named or Manifest(out).sensor(), columns)
    with over_scans("knn-refine", running, output.quiet) as run:
        outcome = knn_refine_scans(
            out,
            dataset=dataset,
            sensor=named,
            space=named_label_space(label_space),
            knn=knn,
            selection=selection,
            options=run,
        )
    summary.finish("knn-refine", outcome, out, output, split=selection.split, strict=strict)


def uncertainty(
    context: typer.Context,
    scans: Path | None = arguments.SEVERAL_SCANS,
    out: Path = arguments.OUT,
    *,
    samples: int = option("Monte-Carlo passes per scan.", default=30),
    seed: int = option("Random seed of dropout masks and noise.", default=0),
    aleatoric: Literal["copies", "paper", "none"] = option(
        "Method for aleatoric and total uncertainty: eight noisy copies of each scan, or "
        "propagation of the noise through the network as in the paper.",
        default="copies",
    ),
    dataset: Path | None = arguments.DATASET,
    selection: ScanSelection,
    topic: str | None = arguments.TOPIC,
    classes: str | None = arguments.CLASSES,
    settings: arguments.Network,
    knn: KnnParameters,
    running: RunOptions,
    strict: bool = arguments.STRICT,
    output: console.Output,
) -> None:
    """Predict the class of every point and its epistemic, aleatoric and total uncertainty.

    Example: salsanext uncertainty seq/velodyne out/ --samples 30
    """
    from salsanext_cli.commands.stages.uncertainty import uncertainty as stage
    from salsanext_cli.core.uncertainty.method import UncertaintyMethod

    source, out = arguments.sources(context, scans, out, dataset, topic)
    with over_scans("uncertainty", running, output.quiet) as run:
        outcome = stage(
            source,
            out,
            settings=replace(settings, classes=named_label_space(classes)),
            knn=knn,
            method=UncertaintyMethod(samples, seed, aleatoric),
            selection=selection,
            options=run,
        )
    summary.finish("uncertainty", outcome, out, output, strict=strict)
