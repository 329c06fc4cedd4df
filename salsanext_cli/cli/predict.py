# SPDX-License-Identifier: MIT
"""`salsanext predict`."""

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.progress import over_scans
from salsanext_cli.errors import UsageError
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.options import RunOptions

if TYPE_CHECKING:
    from salsanext_cli.parallel.run import Outcome


def predict(
    scans: options.Scans = None,
    out: options.Out = Path("out"),
    *,
    pixel_labels: Annotated[
        bool, typer.Option("--pixel-labels", help="Also write the label of every pixel.")
    ] = False,
    probabilities: Annotated[
        bool,
        typer.Option("--probabilities", help="Also write the class probabilities of every point."),
    ] = False,
    error: Annotated[
        bool,
        typer.Option(
            "--error",
            help="Also write the probability that each label is wrong, if the weights know it.",
        ),
    ] = False,
    reject: Annotated[
        float | None,
        typer.Option(
            metavar="ERROR",
            help="Leave points unlabelled whose label is wrong with a higher probability.",
        ),
    ] = None,
    dataset: options.DataSet = None,
    selection: ScanSelection,
    topic: options.Topic = None,
    classes: options.MergedInto = None,
    network: options.AdaptableNetwork,
    knn: options.Knn,
    batch: Annotated[
        str,
        typer.Option(
            help="Scans computed together, halved when memory runs out; auto: 1 on a CPU, on a "
            "GPU as many as keep it busy.",
            rich_help_panel="Running",
        ),
    ] = "auto",
    running: RunOptions,
    strict: options.Strict = False,
    output: console.Output,
) -> None:
    """Predict the class of every point of every scan.

    Example: salsanext predict seq/velodyne out/
    """
    from salsanext_cli.fitting.label_scan import projected_sensor
    from salsanext_cli.results.layout import ERROR
    from salsanext_cli.stages import predict as stage

    source = options.source(scans, dataset, topic)
    wanted = {"pixel_labels": pixel_labels, "probabilities": probabilities, ERROR: error}
    extras = tuple(name for name in wanted if wanted[name])
    loaded = replace(network.settings(), classes=options.label_space(classes))
    chosen: dict[str, Any] = {"network": loaded, "selection": selection}
    outcome: Outcome
    with over_scans("predict", running, output.quiet) as run:
        if projected_sensor(source) is None:
            outcome = stage.predict_scans(
                source,
                out,
                knn=knn.parameters(),
                extras=extras,
                reject=reject,
                batch=_batch_size(batch),
                options=run,
                **chosen,
            )
        else:
            of_points = {"--probabilities": probabilities, "--error": error}
            _require_no_scans(knn, batch, {**of_points, "--reject": reject is not None})
            outcome = stage.predict_range_images(source, out, options=run, **chosen)
    run_end.finish("predict", outcome, out, output, split=selection.split, strict=strict)


def _require_no_scans(knn: options.Knn, batch: str, of_points: dict[str, bool]) -> None:
    """Refuse options that need scans, where range images of `project` are given."""
    for option in (option for option, wanted in of_points.items() if wanted):
        found = "range images do not tell which points they are of"
        raise UsageError(option, found, "the scans themselves")
    if knn != options.Knn():
        found = "range images are refined by knn-refine"
        raise UsageError("--knn-…", found, "the options given there")
    if batch != "auto":
        raise UsageError("--batch", "range images are computed one by one", "scans")


def _batch_size(text: str) -> int | None:
    """Return the number of scans computed together, None for what suits the device."""
    if text == "auto":
        return None
    if not re.fullmatch(r"\d{1,9}", text, re.ASCII):
        raise UsageError("--batch", repr(text), "auto, or a number of scans")
    return int(text)
