# SPDX-License-Identifier: MIT
"""Commands of the panel Your own data: any scans to data sets, their labels, a submission."""

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import typer

from salsanext_cli.cli import arguments, console, summary
from salsanext_cli.cli.console import over_scans, progress, tell
from salsanext_cli.cli.expansion import Shown
from salsanext_cli.engines.settings import with_columns
from salsanext_cli.errors import counted, printable, with_hint
from salsanext_cli.option_fields import ScanSelection, option_group, own_option
from salsanext_cli.results.query import named_label_space


def inspect(
    scans: arguments.Scans = None,
    *,
    fit: Annotated[
        Path | None,
        typer.Option(help="Write a sensor file (.toml) with view and statistics of the scans."),
    ] = None,
    height: Annotated[int | None, typer.Option(help="Rows of its range image.")] = None,
    width: Annotated[int | None, typer.Option(help="Columns of its range image.")] = None,
    dataset: arguments.DataSet = None,
    selection: ScanSelection,
    topic: arguments.Topic = None,
    label_space: arguments.LabelSpaceName = None,
    sensor: arguments.SensorWithoutWeights = None,
    columns: arguments.Columns = None,
    running: arguments.Unsharded,
    strict: arguments.Strict = False,
    output: console.Output,
) -> None:
    """Summarise a set of scans; fit a sensor to them.

    Example: salsanext inspect my/scans --fit my-sensor.toml
    """
    from salsanext_cli.fitting.field_of_view import view_text
    from salsanext_cli.report.tables import survey_tables
    from salsanext_cli.sensors.sensor import sensor as find_sensor
    from salsanext_cli.stages.inspect import inspect as stage
    from salsanext_cli.stages.inspect import write_sensor

    view = with_columns(find_sensor(sensor or "hdl64"), columns).resized(height, width)
    # For weights to come; those that are there have a size and normalisation of their own.
    images = height is not None or width is not None
    with over_scans("inspect", running, output.quiet) as run:
        found = stage(
            arguments.source(scans, dataset, topic),
            sensor=view,
            space=named_label_space(label_space),
            selection=selection,
            options=run,
            fit=fit is not None,
            images=images,
        )
    if fit is not None:
        fitted = found.fitted_sensor(fit.stem, images=images)
        write_sensor(fit, fitted, images=images, overwrite=running.overwrite)
        output.say(f"inspect: sensor, {view_text(fitted)} → {fit}")
    tables = survey_tables(found.sequences, found.total, found.space, found.sensor)
    output.result(found.to_dict(), tables)
    summary.name_failures(found.failures)
    summary.leave(found.failures, failed=strict and bool(found.warnings))


def convert(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="ROS bag (.bag, .mcap, .db3, a folder) or Ouster recording (.pcap, .osf).",
        ),
    ],
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Root of the data set to write.")
    ],
    *,
    topic: arguments.TopicOfRecording = None,
    every: Annotated[int, typer.Option(help="Take every so many scans only.")] = 1,
    limit: Annotated[int | None, typer.Option(help="At most this number of scans.")] = None,
    running: arguments.Unsharded,
    output: console.Output,
) -> None:
    """Write the scans of a recording as `.bin` files, in SemanticKITTI's layout.

    Example: salsanext convert drive.bag drives/ --every 10
    """
    from salsanext_cli.stages.convert import convert as stage

    source = arguments.in_topic(recording, topic)
    with over_scans("convert", running, output.quiet) as run:
        outcome = stage(source, folder, every=every, limit=limit, options=run)
    summary.finish("convert", outcome, folder, output)


@option_group
class PickOptions:
    """Number and kind of the scans that `pick` takes."""

    count: int = own_option("Number of scans to pick.", default=10)
    seed: int = own_option("Seed of the dropout masks.", default=0)
    labelled: list[Path] | None = own_option(
        "Data set of scans that are labelled already: others are picked, unlike them; may be given "
        "several times.",
        metavar="DATASET",
    )


def pick(
    scans: arguments.RequiredScans,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Root of the data set to write.")],
    *,
    choice: PickOptions,
    selection: Annotated[
        ScanSelection, Shown(limit={"help": "Look at this number of scans only, evenly spaced."})
    ],
    topic: arguments.Topic = None,
    settings: arguments.Network,
    running: arguments.Unsharded,
    strict: arguments.Strict = False,
    output: console.Output,
) -> None:
    """Pick the scans most worth labelling; write them as a data set with labels to correct.

    Example: salsanext pick my/drive to-label/ --count 10
    """
    from salsanext_cli.report.picked import picked_table
    from salsanext_cli.stages.pick import pick as stage

    with over_scans("pick", running, output.quiet) as run:
        found = stage(
            arguments.in_topic(scans, topic),
            out,
            **asdict(choice) | {"labelled": choice.labelled or ()},
            settings=settings,
            selection=selection,
            options=run,
        )
    table = picked_table(found.picked) if found.picked else None
    output.result(found.to_dict() | {"out": str(out)}, table)
    outcome, doubted = found.outcome, found.warnings
    summary.name_failures(outcome.failures)
    already = f", {outcome.skipped} there already" if outcome.skipped else ""
    failed = f", {len(outcome.failures)} failed" if outcome.failures else ""
    chosen = f"{len(found.picked):,} of {counted(found.scans, 'scan')}"
    output.say(f"pick: {chosen}{already}{failed} → {out}")
    if found.picked:
        started = ["--weights", str(settings.weights)] if settings.weights else []
        training = ["train", str(out), "RUN", "--recipe", "finetune", *started]
        following = shlex.join(["salsanext", *training])
        edited = shlex.join(["salsanext", "import-labels", "EDITED", str(out)])
        output.say(f"next: correct the labels, take them back with `{edited}`, then `{following}`")
    summary.leave(outcome.failures, failed=strict and bool(doubted))


def import_labels(
    edited: Annotated[
        Path,
        typer.Argument(
            metavar="EDITED",
            help="Cloud with a label scalar (.ply, .pcd, .las, .laz), .label or .npy file, or "
            "folder of such files.",
        ),
    ],
    dataset: Annotated[
        Path, typer.Argument(metavar="DATASET", help="Data set of pick, or folder of scans.")
    ],
    *,
    scalar: Annotated[
        str | None,
        typer.Option(help="Scalar that holds the labels.", show_default="the only label there is"),
    ] = None,
    ids: Annotated[
        Path | None,
        typer.Option(
            "--map",
            help="YAML file that maps a tool's ids to classes by name or raw id, such as 3: car.",
            show_default="raw ids of the label space",
        ),
    ] = None,
    label_space: arguments.LabelSpaceName = None,
    columns: arguments.Columns = None,
    overwrite: arguments.Overwrite = False,
    output: console.Output,
) -> None:
    """Take back the labels that a labelling tool wrote, as the label files of a data set.

    Example: salsanext import-labels edited/ to-label/
    """
    from salsanext_cli.report.tables import imported_lines, imported_table
    from salsanext_cli.sensors.sensor import sensor
    from salsanext_cli.stages.import_labels import import_labels as stage

    with progress("import-labels", output.quiet) as bar:
        made = stage(
            *(edited, dataset),
            scalar=scalar,
            ids=ids,
            space=named_label_space(label_space),
            sensor=with_columns(sensor("hdl64"), columns),
            overwrite=overwrite,
            progress=bar,
        )
    output.result(made.to_dict(), imported_table(made.scans) if made.scans else None)
    for failure in made.failures:
        tell(f"error: {with_hint(failure.reason, failure.hint)}")
    for line in imported_lines(made, dataset):
        output.say(printable(line))
    raise typer.Exit(console.FAILED if made.failures else console.DONE)


@option_group
class Streets:
    """Numbers of the streets of `synth`."""

    train: int = own_option("Number of sequences for training.", default=8)
    valid: int = own_option("Number of sequences for validation.", default=2)
    test: int = own_option("Number of sequences for testing.", default=0)
    scans: int = own_option("Scans per sequence.", default=20)
    spacing: float = own_option("Distance driven between two scans, in metres.", default=3.0)
    sensor: Literal["hdl64", "random"] = own_option(
        "An HDL-64E, or a random sensor for each sequence.", default="hdl64"
    )
    seed: int = own_option("The same seed gives the same bytes.", default=0)


def synth(
    out: Annotated[Path, typer.Argument(metavar="DATASET", help="Root of the new data set.")],
    *,
    streets: Streets,
    jobs: arguments.Jobs = 1,
    overwrite: arguments.Overwrite = False,
    output: console.Output,
) -> None:
    """Generate labelled scans of synthetic streets, in SemanticKITTI's layout.

    Example: salsanext synth streets/ --train 8 --valid 2 --scans 20
    """
    from salsanext_cli.stages.synth import synthesise

    with progress("synth", output.quiet, unit="sequences") as on_progress:
        made = synthesise(
            out, **asdict(streets), jobs=jobs, overwrite=overwrite, progress=on_progress
        )
    output.result(made)
    points = sum(made["points"].values())
    output.say(f"synth: {counted(made['scans'], 'scan')}, {points:,} points → {out}")


def submit(
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="Folder with predictions of the test split.")
    ],
    target: Annotated[Path, typer.Argument(metavar="ZIP", help="File to write (.zip).")],
    *,
    description: Annotated[
        Path | None, typer.Option(help="Text file about the method, packed as description.txt.")
    ] = None,
    dataset: arguments.DataSetOfResults = None,
    label_space: arguments.LabelSpaceName = None,
    overwrite: arguments.Overwrite = False,
    output: console.Output,
) -> None:
    """Check the predictions of the test split and pack them for SemanticKITTI's benchmark.

    Example: salsanext submit out/ submission.zip
    """
    from salsanext_cli.stages.submit import submit as stage

    with progress("submit", output.quiet, unit="files") as on_progress:
        made = stage(
            out,
            target,
            dataset=dataset,
            space=named_label_space(label_space),
            description=description,
            overwrite=overwrite,
            progress=on_progress,
        )
    output.result(made.to_dict() | {"zip": str(target)})
    for problem in made.problems:
        tell(f"error: {problem.text}")
    if made.problems:
        tell(f"submit: {counted(len(made.problems), 'problem')}, {target} is not written")
        raise typer.Exit(console.FAILED)
    output.say(f"submit: {counted(made.scans, 'scan')} → {target}")
