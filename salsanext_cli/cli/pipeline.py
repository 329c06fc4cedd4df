# SPDX-License-Identifier: MIT
"""Commands of the panel Pipeline that make labels of scans, but `train`."""

import re
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from salsanext_cli.cli import arguments, console, summary
from salsanext_cli.cli.console import over_scans
from salsanext_cli.cli.expansion import Without
from salsanext_cli.engines.settings import AUTO, COLUMNS_HELP, NetworkSettings, with_columns
from salsanext_cli.errors import UsageError, counted
from salsanext_cli.option_fields import KnnParameters, ScanSelection, option_group, own_option
from salsanext_cli.parallel.run_options import RunOptions
from salsanext_cli.results.query import ResultQuery, named_label_space

if TYPE_CHECKING:
    from salsanext_cli.parallel.run import Outcome

MANY_SCANS = 100  # Fewer take so little time that no faster option is named
WAIT_S = 1.0  # Time between two looks at whether another run has ended


def project(
    context: typer.Context,
    scans: arguments.SeveralScans = None,
    out: arguments.Out = Path("out"),
    *,
    dataset: arguments.DataSet = None,
    selection: ScanSelection,
    topic: arguments.Topic = None,
    settings: Annotated[arguments.Network, Without({"device", "precision", "engine", "intensity"})],
    running: RunOptions,
    strict: arguments.Strict = False,
    output: console.Output,
) -> None:
    """Project scans onto range images and write these, for `predict` or your own programs.

    Example: salsanext project seq/velodyne out/
    """
    from salsanext_cli.stages.project import project_scans

    source, out = arguments.sources(context, scans, out, dataset, topic)
    with over_scans("project", running, output.quiet) as run:
        outcome = project_scans(
            source,
            out,
            sensor=settings.named_sensor() or settings.trained_sensor(),
            fit=settings.fits_view,
            selection=selection,
            options=run,
        )
    sensor = None if settings.sensor == AUTO else settings.sensor
    named = {"--weights": settings.weights, "--sensor": sensor}
    more = [word for name, value in named.items() if value for word in (name, str(value))]
    summary.finish("project", outcome, out, output, *more, strict=strict)


@option_group
class Extras:
    """Results that `predict` writes besides the labels, and labels that it does not give."""

    pixel_labels: bool = own_option("Also write the label of every pixel.", default=False)
    probabilities: bool = own_option(
        "Also write the class probabilities of every point.", default=False
    )
    error: bool = own_option(
        "Also write the probability that each label is wrong, if the weights know it.",
        default=False,
    )
    fuse: bool = own_option(
        "Then fuse the scans of each sequence, as `fuse` does, into OUT/fused.", default=False
    )
    objects: bool = own_option(
        "Number the vehicles, people and riders in the upper 16 bits of the labels, and write "
        "their boxes.",
        default=False,
    )
    reject: str | None = own_option(
        "Leave points unlabelled whose label is wrong with a higher probability; risk: by the "
        "threshold that `tune risk` chose.",
        metavar="ERROR",
    )

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
        """Error above which points are unlabelled, as `predict_scans` takes it."""
        return "risk" if self.reject == "risk" else arguments.share("--reject", self.reject)

    def require_fusable(self) -> None:
        """Refuse what fused labels do not have."""
        if self.objects or self.reject is not None:
            found, hint = "with --objects or --reject", "those are of the labels of single scans"
            raise UsageError("--fuse", found, "one of them", hint)


def predict(
    context: typer.Context,
    scans: arguments.SeveralScans = None,
    out: arguments.Out = Path("out"),
    *,
    extras: Extras,
    dataset: arguments.DataSet = None,
    selection: ScanSelection,
    topic: arguments.Topic = None,
    classes: arguments.MergedInto = None,
    settings: arguments.Network,
    knn: KnnParameters,
    batch: Annotated[
        str,
        arguments.running_option(
            help="Scans computed together, halved when memory runs out; auto: 1 on a CPU, on a "
            "GPU as many as keep it busy."
        ),
    ] = AUTO,
    running: RunOptions,
    strict: arguments.Strict = False,
    output: console.Output,
) -> None:
    """Predict the class of every point of every scan.

    Example: salsanext predict seq/velodyne out/
    """
    from salsanext_cli.fitting.label_scan import projected_sensor
    from salsanext_cli.stages.predict import predict_range_images, predict_scans

    source, out = arguments.sources(context, scans, out, dataset, topic)
    if extras.fuse:
        from salsanext_cli.stages.fuse import require_fusable

        extras.require_fusable()
        require_fusable(source, out, running)
    settings = replace(settings, classes=named_label_space(classes))
    with over_scans("predict", running, output.quiet) as run:
        if not isinstance(source, Path) or projected_sensor(source) is None:
            outcome: Outcome = predict_scans(
                *(source, out),
                settings=settings,
                knn=knn,
                extras=extras.names,
                reject=extras.threshold,
                batch=_batch_size(batch),
                selection=selection,
                options=run,
            )
        else:
            names = ("probabilities", "error", "fuse", "objects", "reject")
            _require_no_scans(knn, batch, {f"--{name}": getattr(extras, name) for name in names})
            outcome = predict_range_images(
                source, out, settings=settings, selection=selection, options=run
            )
    results, split, advice = out, selection.split, _advice(settings, outcome, out)
    if extras.fuse and outcome.done + outcome.skipped:
        outcome, results = _then_fused(outcome, out, selection, running, output)
    end = partial(summary.finish, split=split, strict=strict, results=results, advice=advice)
    end("predict", outcome, out, output)


def _advice(settings: NetworkSettings, outcome: "Outcome", out: Path) -> str:
    """Return a line about a faster option for a long run; an empty text if there is none."""
    from salsanext_cli.engines.device import advises_int8
    from salsanext_cli.network.card import read_card
    from salsanext_cli.results.manifest import Manifest

    if settings.precision != AUTO or outcome.done <= MANY_SCANS:
        return ""
    recorded = Manifest(out).settings("predict")
    if recorded is None or recorded.engine != "openvino" or not advises_int8(recorded.precision):
        return ""
    how = "" if read_card(settings.path).int8 else ", after `salsanext tune int8`,"
    return f"faster: --precision int8{how} takes about 60 % of the time; 1 % of the labels differ"


def _then_fused(
    outcome: "Outcome",
    out: Path,
    selection: ScanSelection,
    running: RunOptions,
    output: console.Output,
) -> "tuple[Outcome, Path]":
    """Fuse what was predicted; return the outcome of both, and the folder of the fused labels."""
    from salsanext_cli.results.owned_folder import OwnedFolder
    from salsanext_cli.stages.fuse import FUSED, fuse_results

    if (predicted := OwnedFolder(out, "predict")).is_shared():
        output.say("fuse: waiting until another run of `predict` in this folder has ended")
        while predicted.is_shared():
            time.sleep(WAIT_S)
    with over_scans("fuse", running, output.quiet) as run:
        fused = fuse_results(out, query=ResultQuery(selection=selection), options=run)
    output.say(f"fuse: {counted(fused.done, 'scan')} → {out / FUSED}")
    failures = dict.fromkeys((*outcome.failures, *fused.failures))
    if outcome.summary is not None and fused.summary is not None:
        outcome.summary.findings.update(fused.summary.findings)
    return replace(outcome, failures=tuple(failures)), out / FUSED


def _require_no_scans(knn: KnnParameters, batch: str, of_points: dict[str, bool]) -> None:
    """Refuse options that need scans, where range images of `project` are given."""
    for option in (option for option, wanted in of_points.items() if wanted):
        found = "range images do not tell which points they are of"
        raise UsageError(option, found, "the scans themselves")
    if knn != KnnParameters():
        found = "range images are refined by knn-refine"
        raise UsageError("--knn-…", found, "the options given there")
    if batch != AUTO:
        raise UsageError("--batch", "range images are computed one by one", "scans")


def _batch_size(text: str) -> int | None:
    """Return the number of scans computed together, None for what suits the device."""
    if text == AUTO:
        return None
    if not re.fullmatch(r"\d{1,9}", text, re.ASCII):
        raise UsageError("--batch", repr(text), "auto, or a number of scans")
    return int(text)


def knn_refine(
    out: arguments.Out = Path("out"),
    *,
    labels: Annotated[
        Path | None,
        typer.Option(help="Refine the .label files of this folder instead, of any program."),
    ] = None,
    dataset: arguments.DataSetOfResults = None,
    selection: ScanSelection,
    label_space: arguments.LabelSpaceName = None,
    sensor: Annotated[
        str | None,
        arguments.network_option(
            help=arguments.SENSOR_HELP,
            show_default="the sensor of the earlier stages, else hdl64",
        ),
    ] = None,
    columns: Annotated[
        str | None,
        arguments.network_option(
            help=COLUMNS_HELP, show_default="those of the earlier stages, else x,y,z,intensity"
        ),
    ] = None,
    knn: KnnParameters,
    running: RunOptions,
    strict: arguments.Strict = False,
    output: console.Output,
) -> None:
    """Turn labels of pixels into labels of points, or correct labels of points, by neighbours.

    Example: salsanext knn-refine out/
    """
    from salsanext_cli.results.manifest import Manifest
    from salsanext_cli.stages.knn_refine import knn_refine_scans

    seen = arguments.sensor(sensor)
    if columns is not None:
        seen = with_columns(seen or Manifest(out).sensor(), columns)
    with over_scans("knn-refine", running, output.quiet) as run:
        outcome = knn_refine_scans(
            out,
            labels=labels,
            dataset=dataset,
            sensor=seen,
            space=named_label_space(label_space),
            knn=knn,
            selection=selection,
            options=run,
        )
    summary.finish("knn-refine", outcome, out, output, split=selection.split, strict=strict)


def uncertainty(
    context: typer.Context,
    scans: arguments.SeveralScans = None,
    out: arguments.Out = Path("out"),
    *,
    samples: Annotated[int, typer.Option(help="Monte-Carlo passes per scan.")] = 30,
    seed: Annotated[int, typer.Option(help="Seed of the dropout masks and the noise.")] = 0,
    aleatoric: Annotated[
        Literal["copies", "paper", "none"],
        typer.Option(
            help="The sensor's noise, for aleatoric and total uncertainty: by eight noisy copies "
            "of each scan, or carried through the network as in the paper."
        ),
    ] = "copies",
    dataset: arguments.DataSet = None,
    selection: ScanSelection,
    topic: arguments.Topic = None,
    classes: arguments.MergedInto = None,
    settings: arguments.Network,
    knn: KnnParameters,
    running: RunOptions,
    strict: arguments.Strict = False,
    output: console.Output,
) -> None:
    """Predict the class of every point and its epistemic, aleatoric and total uncertainty.

    Example: salsanext uncertainty seq/velodyne out/ --samples 30
    """
    from salsanext_cli.stages.uncertainty import uncertainty as stage
    from salsanext_cli.uncertainty.method import UncertaintyMethod

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
