# SPDX-License-Identifier: MIT
"""`salsanext import-labels`."""

from pathlib import Path

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import argument, option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.console import print_line
from salsanext_cli.commands.line.output.progress import writing
from salsanext_cli.core.texts import printable, with_hint
from salsanext_cli.runs.results.query import named_label_space
from salsanext_cli.runs.sensor_request import with_names


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
    label_space: str | None = declarations.LABEL_SPACE,
    columns: str | None = declarations.COLUMNS,
    overwrite: bool = declarations.OVERWRITE,
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
