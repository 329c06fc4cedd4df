# SPDX-License-Identifier: MIT
"""`salsanext import-labels`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options
from salsanext_cli.cli.progress import progress, tell
from salsanext_cli.errors import counted, printable


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
    label_space: options.LabelSpaceName = None,
    columns: options.Columns = None,
    overwrite: options.Overwrite = False,
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
            space=options.label_space(label_space),
            sensor=options.with_columns(sensor("hdl64"), columns),
            overwrite=overwrite,
            progress=bar,
        )
    output.result(made.to_dict(), imported_table(made.scans) if made.scans else None)
    for failure in made.failures:
        tell(f"error: {failure['reason']}")
    for line in imported_lines(made, dataset):
        output.say(printable(line))
    if merged := sum(len(scan["files"]) > 1 for scan in made.scans):
        output.say(f"merged from several files: {counted(merged, 'scan')}")
    raise typer.Exit(console.FAILED if made.failures else console.DONE)
