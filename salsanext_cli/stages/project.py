# SPDX-License-Identifier: MIT
"""Stage `project`: scans to range images on disk."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from salsanext_cli.fitting.label_scan import project_scan
from salsanext_cli.fitting.scan_fit import fitted_view
from salsanext_cli.measures.scan_summary import RunSummary, ScanSummary
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.manifest import Manifest
from salsanext_cli.results.output_run import OutputRun, output_run
from salsanext_cli.results.selection import choose, scans_of, space_of
from salsanext_cli.results.settings import StageSettings
from salsanext_cli.sensors.sensor import Sensor

FOLDERS = ("range", "pixels")


def write_projected(file: ScanFile, sensor: Sensor, output: OutputRun) -> ScanSummary:
    """Project one scan; write its range image and the pixels of its points."""
    output.require_replaceable(file)
    projected = project_scan(file, sensor)
    output.write_array(file, "range", projected.image.channels)
    output.write_array(file, "pixels", projected.image.pixel_of_point)
    return ScanSummary(file, projected.check)


def project_scans(
    source: Path | Sequence[Path],
    out: Path,
    *,
    sensor: Sensor,
    fit: bool = False,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Project scans to `OUT/sequences/<seq>/range` and `pixels`, to fit with their own view."""
    listed = scans_of(source)
    scans = choose(listed, selection, space_of(listed), source)
    recorded = None if options.overwrite else Manifest(out).settings("project")
    sensor = fitted_view(listed, sensor, recorded.sensor if recorded else None, view=fit)
    settings, summary = StageSettings(sensor=sensor), RunSummary.of_scans(scans, sensor)
    run = output_run(out, "project", settings, FOLDERS, scans, overwrite=options.overwrite)
    with run as output, summary.kept_in(output, scans):
        task = partial(write_projected, sensor=sensor, output=output)
        return run_over_scans(task, scans, options, is_done=output.is_done, summary=summary)
