# SPDX-License-Identifier: MIT
"""Commands on your own data: inspect, convert, pick, import labels, simulate, submit."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from salsanext_cli.commands.line.options import arguments
from salsanext_cli.commands.line.options.expansion import Declared
from salsanext_cli.commands.line.options.option_fields import argument, option, option_group
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.console import print_line
from salsanext_cli.commands.line.output.next_command import next_command
from salsanext_cli.commands.line.output.progress import over_scans, writing
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.texts import counted, printable, with_hint
from salsanext_cli.runs.results.query import named_label_space
from salsanext_cli.runs.results.scan_selection import PICKED_SCANS, ScanSelection
from salsanext_cli.runs.sensor_request import AUTO, with_names

if TYPE_CHECKING:
    from salsanext_cli.commands.picked_labels import PickedLabels
    from salsanext_cli.core.sensors.sensor import Sensor


def inspect(
    scans: Path | None = arguments.SCANS,
    *,
    fit: Path | None = option(
        "Write a sensor file (.toml) with field of view and statistics of the scans."
    ),
    height: int | None = option("Rows of the range image of --fit."),
    width: int | None = option("Columns of the range image of --fit."),
    dataset: Path | None = arguments.DATASET,
    selection: ScanSelection,
    topic: str | None = arguments.TOPIC,
    label_space: str | None = arguments.LABEL_SPACE,
    sensor: str | None = arguments.sensor_option(
        show_default="fitted to the scans, as `predict` does; of --fit, hdl64"
    ),
    columns: str | None = arguments.COLUMNS,
    intensity_field: str | None = arguments.INTENSITY_FIELD,
    origin: str | None = arguments.ORIGIN,
    running: arguments.Unsharded,
    strict: bool = arguments.STRICT,
    output: console.Output,
) -> None:
    """Summarise scans: points, field of view, labels, warnings; fit a sensor file to them.

    Example: salsanext inspect my/scans
    """
    from salsanext_cli.commands.stages.inspect import inspect as stage
    from salsanext_cli.commands.stages.inspect import write_sensor
    from salsanext_cli.core.fitting.sensor_texts import view_text
    from salsanext_cli.io.stated_fields import stated_fields
    from salsanext_cli.report.tables import survey_tables

    sensor = None if sensor == AUTO else sensor
    start = _start_of_fit(sensor, is_written=fit is not None)
    named = with_names(start, columns, intensity_field).resized(height, width)
    # The size and the normalisation are for weights that are still to be trained.
    images = height is not None or width is not None
    with over_scans("inspect", running, output.quiet, at_end=True) as options:
        survey = stage(
            arguments.source(scans, dataset, topic),
            sensor=named,
            space=named_label_space(label_space),
            selection=selection,
            options=options,
            fit=fit is not None,
            images=images,
            as_predict=fit is None and _is_fitted(sensor),
            fit_mounting=not stated_fields(sensor or AUTO).mounting,
            origin=arguments.position("--origin", origin),
        )
    if fit is not None:
        fitted = survey.fitted_sensor(fit.stem, images=images)
        write_sensor(fit, fitted, images=images, overwrite=running.overwrite)
        output.print(f"inspect: sensor, {view_text(fitted)} → {fit}")
    sensor_of_images = None if fit is None else survey.sensor
    tables = None
    if survey.sequences:
        tables = survey_tables(survey.sequences, survey.total, survey.space, sensor_of_images)
    output.result(survey.to_dict(), tables)
    summary.print_failures(survey.failures)
    summary.exit_with_status(survey.failures, failed=strict and bool(survey.warnings))


def _start_of_fit(named: str | None, *, is_written: bool) -> "Sensor":
    """Return the sensor that `inspect` takes or fits: that of the weights unless it is named.

    `is_written`: whether it is for a sensor file, which begins with the HDL-64.
    """
    from salsanext_cli.core.sensors.sensor import presets
    from salsanext_cli.io.sensors import sensor
    from salsanext_cli.io.weights.card_file import default_weights, read_card

    if named is None and not is_written:
        return read_card(default_weights()).sensor
    return sensor(named or "hdl64", presets()["hdl64"])


def _is_fitted(named: str | None) -> bool:
    """Return whether `inspect` fits the field of view: of no sensor, or of a file without one."""
    from salsanext_cli.core.sensors.sensor import presets
    from salsanext_cli.io.stated_fields import stated_fields

    return named is None or (named not in presets() and not stated_fields(named).view)


def convert(
    recording: Path = argument(
        "ROS bag (.bag, .mcap, .db3, a folder), recording of Ouster or Velodyne (.pcap, .osf), or "
        "E57 file.",
        default=...,
        metavar="RECORDING",
    ),
    folder: Path = arguments.NEW_DATASET,
    *,
    topic: str | None = arguments.TOPIC,
    every: int = option("Take only every Nth scan.", default=1),
    limit: int | None = option("Only the first N scans."),
    running: arguments.Unsharded,
    output: console.Output,
) -> None:
    """Write the scans of a recording as `.bin` files, in the layout of SemanticKITTI.

    Example: salsanext convert drive.bag drives/ --every 10
    """
    from salsanext_cli.commands.stages.convert import convert as stage

    source = arguments.in_topic(recording, topic)
    with over_scans("convert", running, output.quiet) as options:
        outcome = stage(source, folder, every=every, limit=limit, options=options)
    following = next_command(outcome, ["predict", folder])
    summary.print_summary_and_exit("convert", outcome, folder, output, following=following)


def pick(
    scans: Path = argument(arguments.SCANS_HELP, default=..., metavar="SCANS"),
    out: Path = arguments.NEW_DATASET,
    *,
    count: int | None = option("Number of scans to pick.", show_default=str(PICKED_SCANS)),
    names: Path | None = option(
        "Pick the scans whose names this text file lists, one per line.", "--from", metavar="FILE"
    ),
    tool: str | None = option(
        "Also write the scans for a labelling tool: point-labeler, segments, sse or supervisely.",
        "--for",
        metavar="TOOL",
    ),
    seed: int = option("Seed of the dropout masks.", default=0),
    labelled: list[Path] | None = option(
        "Data set of labelled scans, which the picked scans should differ from; may be given "
        "several times."
    ),
    selection: Annotated[ScanSelection, Declared(limit=arguments.SUBSET)],
    topic: str | None = arguments.TOPIC,
    settings: arguments.Network,
    running: arguments.Unsharded,
    strict: bool = arguments.STRICT,
    output: console.Output,
) -> None:
    """Pick the scans most worth labelling; write them as a data set with pre-labels to correct.

    Example: salsanext pick my/drive to-label/ --count 10
    """
    from salsanext_cli.commands.line.output.after_pick import lines_after_pick
    from salsanext_cli.commands.picked_labels import label_picked_scans
    from salsanext_cli.commands.stages.pick import pick as stage
    from salsanext_cli.io.labelling_tools.registry import tool_named
    from salsanext_cli.report.picked import picked_table
    from salsanext_cli.runs.results.layouts import TOOL_FOLDER

    if names and count is not None:
        raise UsageError("--count", "chooses scans, and so does --from", "one of both")
    with over_scans("pick", running, output.quiet) as options:
        picking = stage(
            arguments.in_topic(scans, topic),
            out,
            count=PICKED_SCANS if count is None else count,
            seed=seed,
            labelled=labelled or (),
            names=names,
            tool=tool,
            settings=settings,
            selection=selection,
            options=options,
        )
    failures = picking.outcome.failures
    labels = None
    if picking.picked:
        with over_scans("pick", running, output.quiet) as options:
            labels = label_picked_scans(out, settings, options)
        failures = (*failures, *labels.failures)
    tool_folder = None if tool is None or not picking.picked else out / TOOL_FOLDER / tool
    result = picking.to_dict() | {"out": str(out)} | _labels_as_data(labels)
    result["tool_folder"] = tool_folder and str(tool_folder)
    result["failures"] = [failure.to_dict() for failure in failures]
    output.result(result, picked_table(picking.picked) if picking.picked else None)
    summary.print_failures(failures)
    numbers = f"{len(picking.picked):,} of {counted(picking.scans, 'scan')}"
    counts = ", ".join([numbers, *summary.skipped_and_failed_texts(picking.outcome)])
    output.print(f"pick: {counts} → {out}" if picking.picked else f"pick: {counts}")
    if labels is not None:
        labelling_tool = None if tool is None else tool_named(tool)
        lines = lines_after_pick(
            out, picking, labels, settings.weights, labelled or (), labelling_tool
        )
        for line in lines:
            output.print(line)
    summary.exit_with_status(failures, failed=strict and bool(picking.warnings))


def _labels_as_data(labels: "PickedLabels | None") -> dict[str, object]:
    """Return plain data about the labels of picked scans for JSON."""
    decision = labels.verdict.decision if labels and labels.verdict else None
    return {"predicted": labels and str(labels.folder), "decision": decision}


def import_labels(
    edited: Path = argument(
        "Labelled point cloud (.ply, .pcd, .las, .laz), .label or .npy file, file of a labelling "
        "tool, or a folder of such files.",
        default=...,
        metavar="EDITED",
    ),
    dataset: Path = argument(
        "Data set of `pick`, or folder of scans.", default=..., metavar="DATASET"
    ),
    *,
    scalar: str | None = option(
        "Scalar field with the labels.", show_default="label, class or similar"
    ),
    ids: Path | None = option(
        "YAML file that maps the ids of the tool to class names or raw ids, such as 3: car.",
        "--map",
        show_default="raw ids of the label space",
    ),
    label_space: str | None = arguments.LABEL_SPACE,
    columns: str | None = arguments.COLUMNS,
    overwrite: bool = arguments.OVERWRITE,
    output: console.Output,
) -> None:
    """Import the labels that a labelling tool wrote as the label files of a data set.

    Example: salsanext import-labels edited/ to-label/
    """
    from salsanext_cli.commands.stages.import_labels import import_labels as stage
    from salsanext_cli.io.sensors import sensor
    from salsanext_cli.report.tables import imported_lines, imported_table

    with writing("import-labels", output.quiet) as bar:
        imported = stage(
            edited,
            dataset,
            scalar=scalar,
            ids=ids,
            space=named_label_space(label_space),
            sensor=with_names(sensor("hdl64"), columns),
            overwrite=overwrite,
            progress=bar,
        )
    table = imported_table(imported.scans) if imported.scans else None
    output.result(imported.to_dict(), table)
    for failure in imported.failures:
        print_line(f"error: {with_hint(failure.reason, failure.hint)}")
    for line in imported_lines(imported, dataset):
        output.print(printable(line))
    summary.exit_with_status(imported.failures)


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
    out: Path = arguments.NEW_DATASET,
    *,
    scenes: Scenes,
    jobs: int = arguments.JOBS,
    cluster: str | None = arguments.CLUSTER,
    overwrite: bool = arguments.OVERWRITE,
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


def submit(
    out: Path = argument(
        "Folder with the predictions of the test split.", default=..., metavar="OUT"
    ),
    target: Path = argument("File to write (.zip).", default=..., metavar="ZIP"),
    *,
    description: Path | None = option("Text file about the method, packed as description.txt."),
    dataset: Path | None = arguments.DATASET_OF_RESULTS,
    label_space: str | None = arguments.LABEL_SPACE,
    overwrite: bool = arguments.OVERWRITE,
    output: console.Output,
) -> None:
    """Check the predictions of the test split and pack them for the benchmark of SemanticKITTI.

    Example: salsanext submit out/ submission.zip
    """
    from salsanext_cli.commands.stages.submit import submit as stage

    with writing("submit", output.quiet, unit="files", at_end=True) as on_progress:
        submission = stage(
            out,
            target,
            dataset=dataset,
            space=named_label_space(label_space),
            description=description,
            overwrite=overwrite,
            progress=on_progress,
        )
    written = str(target) if submission.is_packed else None
    output.result({"stage": "submit", **asdict(submission), "zip": written})
    for problem in submission.problems:
        print_line(f"error: {problem.text}")
    if submission.problems:
        cases = sum(len(problem.cases) for problem in submission.problems)
        kinds = counted(len(submission.problems), "kind")
        counts = f"{counted(cases, 'problem')} of {kinds}, listed in full by --json"
        output.print(f"submit: {counts}; nothing was packed")
    else:
        output.print(f"submit: {counted(submission.scans, 'scan')} → {target}")
    summary.exit_with_status(submission.problems)
