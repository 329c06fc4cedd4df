# SPDX-License-Identifier: MIT
"""`salsanext inspect`."""

from pathlib import Path
from typing import TYPE_CHECKING

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.progress import over_scans
from salsanext_cli.commands.line.values.scans_and_out import scan_source
from salsanext_cli.commands.line.values.typed_values import typed_position
from salsanext_cli.runs.results.query import named_label_space
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.sensor_request import AUTO, with_names

if TYPE_CHECKING:
    from salsanext_cli.core.sensors.sensor import Sensor


def inspect(
    scans: Path | None = declarations.SCANS,
    *,
    fit: Path | None = option(
        "Write a sensor file (.toml) with field of view and statistics of the scans."
    ),
    height: int | None = option("Rows of the range image of --fit."),
    width: int | None = option("Columns of the range image of --fit."),
    dataset: Path | None = declarations.DATASET,
    selection: ScanSelection,
    topic: str | None = declarations.TOPIC,
    label_space: str | None = declarations.LABEL_SPACE,
    sensor: str | None = declarations.sensor_option(
        show_default="fitted to the scans, as `predict` does; of --fit, hdl64"
    ),
    columns: str | None = declarations.COLUMNS,
    intensity_field: str | None = declarations.INTENSITY_FIELD,
    origin: str | None = declarations.ORIGIN,
    running: declarations.Unsharded,
    strict: bool = declarations.STRICT,
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
            scan_source(scans, dataset, topic),
            sensor=named,
            space=named_label_space(label_space),
            selection=selection,
            options=options,
            fit=fit is not None,
            images=images,
            as_predict=fit is None and _is_fitted(sensor),
            fit_mounting=not stated_fields(sensor or AUTO).mounting,
            origin=typed_position("--origin", origin),
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
