# SPDX-License-Identifier: MIT
"""Stage `inspect`: size, field of view and classes of scans; a sensor fitted to them."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from salsanext_cli.core.checks.scan_checks import OTHER_SENSOR_HINT, check_scan, fit_hint
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import NoInputError
from salsanext_cli.core.fitting.sensor_groups import sensor_groups
from salsanext_cli.core.geometry.intensity import NO_INTENSITY
from salsanext_cli.core.geometry.point_sample import measured_ranges
from salsanext_cli.core.geometry.projection import project
from salsanext_cli.core.geometry.sensor_frame import without_ego
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.measures.survey import Survey, survey
from salsanext_cli.core.plain_data import plain
from salsanext_cli.core.records import Origin
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted
from salsanext_cli.io.files.atomic import write_target
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.io.weights.card_file import default_weights, read_card
from salsanext_cli.runs.fit.mixed_sensors import SEPARATE_FOLDERS_HINT
from salsanext_cli.runs.fit.scan_sample import sample_of_files
from salsanext_cli.runs.fit.sensor_fit import fitted_view
from salsanext_cli.runs.fit.stated_origin import origin_in_frame
from salsanext_cli.runs.loop.run import Failure, RunOptions, run_over_scans
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import select_scans, space_of
from salsanext_cli.runs.summary.run_summary import RunSummary
from salsanext_cli.runs.summary.scan_summary import ScanSummary
from salsanext_cli.runs.summary.scan_warnings import ScanWarning

MIN_POINTS_OF_FIT = 1000  # A fit skips one point in a thousand at either edge.
MIN_FIELD_OF_VIEW_DEG = 1.0  # A planar scanner has less.


@dataclass(frozen=True, slots=True, kw_only=True)
class Inspection:
    """Result of inspecting scans."""

    sequences: dict[str, Survey]  # By name
    total: Survey  # Survey of all scans
    sensor: Sensor  # Sensor of the range images
    space: LabelSpace
    failures: tuple[Failure, ...]  # Scans that are unreadable or not in metres
    warnings: list[ScanWarning]  # Reasons to doubt scans

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {
            "stage": "inspect",
            "sensor": self.sensor.to_dict(),
            "total": self.total.to_dict(),
            "sequences": {name: survey.to_dict() for name, survey in self.sequences.items()},
            "failures": [failure.to_dict() for failure in self.failures],
            "warnings": plain(self.warnings),
        }

    def fitted_sensor(self, name: str, *, images: bool = True) -> Sensor:
        """Return the fitted sensor with a name; `images` as for `inspect`."""
        _require_fit(name, self.total)
        if not images:
            return replace(self.sensor, name=name)
        return replace(
            _with_field_of_view(self.sensor, self.total),
            name=name,
            means=tuple(round(mean, 4) for mean in self.total.means),
            stds=tuple(round(std, 4) for std in self.total.stds),
        )


def inspect(
    source: Path,
    *,
    sensor: Sensor,
    space: LabelSpace | None = None,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
    fit: bool = False,
    images: bool = True,
    as_predict: bool = False,
    fit_mounting: bool = True,
    origin: Origin | None = None,
) -> Inspection:
    """Survey and check scans, and fit a sensor to them.

    Parameters
    ----------
    source : Path
        Scans.
    sensor : Sensor
        Sensor of the range images.
    space : LabelSpace, optional
        Label space of the labels; by default that of the data set.
    selection : ScanSelection, optional
        Choice of the scans; all by default.
    options : RunOptions, optional
        Workers, progress, and treatment of failures.
    fit : bool
        Whether to fit the sensor to the scans, as `predict` does.
    images : bool
        Whether the fit is for new weights: the field of view holds all points, and the images are
        normalised by the scans.
    as_predict : bool
        Whether to judge scans by the sensor that `predict` fits to them, or by several.
    fit_mounting : bool
        Whether a fit estimates the mounting too; else that of the sensor stays.
    origin : 3 floats, optional
        Position of the sensor in the coordinates of the files, in metres, which no fit changes.

    Returns
    -------
    Inspection

    Raises
    ------
    NoInputError
        If there are no scans, or a fit is to scans of several sensors.
    """
    scans = select_scans(source, selection, space)
    files = find_scans(source)
    hint = OTHER_SENSOR_HINT if fit else fit_hint()
    if origin is not None:
        fit_mounting = False
        sensor = replace(sensor, origin=origin_in_frame(origin, files, sensor))
    if fit:
        sensor = _fitted_sensor(source, files, sensor, mounting=fit_mounting)
        if images:
            # This pass fits the field of view that scans are checked against.
            first_pass = _inspect(scans, sensor, space, options)
            if first_pass.total.pixels:
                sensor = _with_field_of_view(sensor, first_pass.total)
    elif as_predict:
        sensor = fitted_view(files, sensor, mounting=fit_mounting)
        hint = OTHER_SENSOR_HINT
    elif len(sensor_groups(sample_of_files(files, sensor).scans, sensor)) > 1:
        hint = SEPARATE_FOLDERS_HINT
    return _inspect(scans, sensor, space, options, hint)


def _fitted_sensor(
    source: Path, files: list[ScanFile], sensor: Sensor, *, mounting: bool
) -> Sensor:
    """Return the sensor fitted to scans as `predict` does; refuse scans of several sensors."""
    trained = read_card(default_weights()).sensor
    start = replace(sensor, fov_up=trained.fov_up, fov_down=trained.fov_down)
    fitted = fitted_view(files, start, mounting=mounting)
    if fitted.others:
        problem = f"has scans of {len(fitted.members)} sensors"
        raise NoInputError(source, problem, "scans of one sensor", SEPARATE_FOLDERS_HINT)
    return fitted


def _inspect(
    scans: list[ScanFile],
    sensor: Sensor,
    space: LabelSpace | None,
    options: RunOptions,
    hint: str = "",
) -> Inspection:
    """Survey the scans; check them if there is a hint for findings that a fit may remove."""
    sequences: dict[str, Survey] = {}
    summary = RunSummary(sensor=sensor)

    def add(result: tuple[Survey, ScanSummary]) -> None:
        counts, scan = result
        name = scan.file.sequence
        sequences[name] = sequences.get(name, Survey()) + counts
        if hint:
            summary.add(scan)

    task = partial(_inspect_scan, sensor=sensor, hint=hint)
    outcome = run_over_scans(task, scans, options, on_result=add)
    sequences = dict(sorted(sequences.items()))
    return Inspection(
        sequences=sequences,
        total=sum(sequences.values(), start=Survey()),
        sensor=sensor,
        space=space or space_of(scans),
        failures=outcome.failures,
        warnings=summary.finished().warnings(),
    )


def _inspect_scan(file: ScanFile, sensor: Sensor, hint: str) -> tuple[Survey, ScanSummary]:
    """Read, check, project and survey a scan."""
    scan = read_scan(file.path, sensor)
    sensor = sensor_of(scan, sensor)
    # The scale of the intensity does not matter, since `predict` matches it.
    matched = replace(sensor, intensity_quantiles=NO_INTENSITY)
    check = check_scan(file.path, scan, matched, matched, hint)
    raw = read_labels(file.label_path, len(scan)) if present(file.label_path) else None
    counts = survey(without_ego(scan, sensor), project(scan, sensor), raw)
    _, measured = measured_ranges(scan.points)
    # Points on the vehicle have a measurement, although the survey does not use it.
    counts.invalid = int(len(scan) - measured.sum())
    return counts, ScanSummary(file=file, check=check)


def _require_fit(name: str, total: Survey) -> None:
    """Refuse to fit a sensor to scans that do not show its field of view."""
    measured = total.points - total.invalid
    up, down = total.field_of_view()
    if measured < MIN_POINTS_OF_FIT or up - down < MIN_FIELD_OF_VIEW_DEG:
        view = f"a field of view of {up - down:.2f}°, from {up:+.2f}° to {down:+.2f}°"
        problem = f"scans have {counted(measured, 'point')} with a measurement and {view}"
        expected = f"at least {MIN_POINTS_OF_FIT} points and {MIN_FIELD_OF_VIEW_DEG:g}°"
        hint = "fit a sensor to whole scans of a 3D LiDAR, with z up and its origin at the sensor"
        raise NoInputError(name, problem, expected, hint)


def _with_field_of_view(sensor: Sensor, total: Survey) -> Sensor:
    up, down = total.field_of_view()
    return replace(sensor, fov_up=round(up, 2), fov_down=round(down, 2))


def write_sensor(
    path: Path, sensor: Sensor, *, images: bool = True, overwrite: bool = False
) -> None:
    """Write a sensor to a TOML file for `--sensor`.

    Parameters
    ----------
    path : Path
        File to write.
    sensor : Sensor
        Sensor to write.
    images : bool
        Whether to write the size and normalisation of the images too.
    overwrite : bool
        Whether to replace an existing file.

    Raises
    ------
    OutputError
        If the file cannot be written, or may not replace another.
    """
    write_target(path, sensor.to_toml(images=images).encode(), overwrite=overwrite)
