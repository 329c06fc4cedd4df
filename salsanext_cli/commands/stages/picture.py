# SPDX-License-Identifier: MIT
"""Stage `picture`: pictures of scans and results."""

import logging
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.wording import argument
from salsanext_cli.io.sensors import sensor as named_sensor
from salsanext_cli.report.colours import CLASS_COLOURS, Scales, common_scales, require_colouring
from salsanext_cli.report.scan_pictures import known_views, picture_of_results
from salsanext_cli.runs.fit.sensor_fit import fitted_view
from salsanext_cli.runs.labelling.foreign_labels import warn_of_foreign_labels
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.records.stage_settings import PictureSettings
from salsanext_cli.runs.results.output_run import OutputRun, output_run
from salsanext_cli.runs.results.paths import COLOURINGS, PREDICTION_STAGES, ScanFile
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ChosenResults, ResultFolder
from salsanext_cli.runs.results.scan_results import scalar_columns

STAGE: Final = "picture"
FOLDER = "pictures"

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureTask:
    """Task that draws a scan in some colours, or in all colours that it has."""

    colours: Sequence[str]  # Empty for all
    scales: Scales
    space: LabelSpace
    sensor: Sensor
    output: OutputRun
    classes: LabelSpace | None  # Classes into which predicted ones are merged
    truth_in: tuple[LabelSpace, LabelSpace] | None  # As of `ResultFolder.read`

    def __call__(self, file: ScanFile) -> None:
        """Write the picture of a scan."""
        self.output.require_replaceable(file)
        folder = ResultFolder(self.output.root)
        results = folder.read(file, self.sensor, self.classes, self.truth_in)
        columns = scalar_columns(results, self.space)
        for colour in self.colours:
            if colour not in columns:
                raise folder.missing_column(colour, file)
        views = self.colours or known_views(columns)
        strips = self.colours or [colour for colour in COLOURINGS if colour in columns]
        png = picture_of_results(
            file.name, results, self.space, self.sensor, self.scales, views, strips
        )
        self.output.write(self.output.path(file, FOLDER), png)


def _draws_truth(chosen: ChosenResults, colours: Collection[str], sensor: Sensor) -> bool:
    """Return whether pictures need the true labels: if asked for, or if there are usable ones."""
    if colours:
        return bool({"truth", "wrong"} & {*colours})
    return not warn_of_foreign_labels(chosen.scans, chosen.labels, sensor)


def picture(
    out: Path,
    *,
    colours: Collection[str] = (),
    scale: tuple[float, float] | None = None,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Write `OUT/sequences/<seq>/pictures/*.png`.

    Parameters
    ----------
    out : Path
        Folder with results.
    colours : collection of str
        Some of `COLOURS`; by default every colour that a scan has.
    scale : tuple of float, optional
        Values at the ends of the colour map, for a single colour.
    query : ResultQuery, optional
        Choice of the scans, their data set and classes.
    options : RunOptions, optional
        Workers, progress, and treatment of failures and of existing results.

    Returns
    -------
    Outcome
    """
    require_colouring(colours, scale, "colours")
    _require_scalable(colours, scale)
    results = ResultFolder(out, query.dataset)
    chosen = results.chosen(query)
    colours = _drawn_colours(results, chosen.scans, colours)
    origins = results.manifest.origins(PREDICTION_STAGES)
    earlier = _recorded(results)
    is_outdated = earlier is not None and earlier.origins != origins
    overwrite = options.overwrite or is_outdated
    continued = None if overwrite else earlier
    sensor = _sensor_of_images(results, chosen.scans, continued)
    scales = _scales(results, chosen, colours, scale, continued, sensor)
    settings = PictureSettings(
        colours=tuple(colours),
        scales=scales,
        sensor=sensor,
        label_space=chosen.space,
        origins=origins,
    )
    run = output_run(
        out, STAGE, settings, (FOLDER,), chosen.scans, overwrite=overwrite, record_scans=False
    )
    draws_truth = _draws_truth(chosen, colours, sensor)
    with run as output:
        task = PictureTask(
            colours=colours,
            scales=scales,
            space=chosen.space,
            sensor=sensor,
            output=output,
            classes=query.classes,
            truth_in=(chosen.labels, chosen.space) if draws_truth else None,
        )
        outcome = run_over_scans(task, chosen.scans, options, is_done=output.is_done)
        log.log(NOTICE, "pictures: %s", out / "sequences/*" / FOLDER)
    return replace(outcome, missing=chosen.missing)


def _require_scalable(colours: Collection[str], scale: tuple[float, float] | None) -> None:
    """Refuse a scale for anything but a single colour of values."""
    if scale and (len(colours) != 1 or {*colours} & {*CLASS_COLOURS}):
        problem = f"{argument('colours')} is {', '.join(colours) or 'missing'}"
        raise UsageError(argument("scale"), problem, "a single colour of values, such as error")


def _drawn_colours(
    results: ResultFolder, scans: Sequence[ScanFile], colours: Collection[str]
) -> list[str]:
    """Return each colour once, with a kind of uncertainty for "uncertainty"; refuse absent ones."""
    kind = results.meant_uncertainty(scans)
    drawn = dict.fromkeys(kind if colour == "uncertainty" else colour for colour in colours)
    for colour in drawn:
        results.require_column(colour, scans)
    return list(drawn)


def _sensor_of_images(
    results: ResultFolder, scans: Sequence[ScanFile], continued: PictureSettings | None
) -> Sensor:
    """Return the sensor of the range images: as recorded, else fitted to the scans."""
    recorded = results.manifest.known_sensor() or (continued.sensor if continued else None)
    return recorded or fitted_view(scans, named_sensor("hdl64"))


def _scales(
    results: ResultFolder,
    chosen: ChosenResults,
    colours: Sequence[str],
    scale: tuple[float, float] | None,
    continued: PictureSettings | None,
    sensor: Sensor,
) -> Scales:
    """Return the ends of the scale of each colour of values: given, as recorded, or common ones.

    Parameters
    ----------
    results : ResultFolder
        Results.
    chosen : ChosenResults
        The chosen scans.
    colours : sequence of str
        Colours of the pictures; empty for all.
    scale : tuple of float, optional
        Ends of the scale of the only colour.
    continued : PictureSettings, optional
        Settings of the pictures that are continued, whose scales stay.
    sensor : Sensor
        Sensor of the range images.

    Returns
    -------
    dict
        Ends by colour.
    """
    values = [
        colour
        for colour in colours or COLOURINGS
        if colour not in CLASS_COLOURS and results.with_column(colour, chosen.scans)
    ]
    scales: Scales = {}
    if scale is not None:
        scales = dict.fromkeys(values, scale)
    elif continued is not None:
        scales = dict(continued.scales or {})
    unscaled = [colour for colour in values if colour not in scales]
    return scales | common_scales(results.root, chosen.scans, unscaled, chosen.space, sensor)


def _recorded(results: ResultFolder) -> PictureSettings | None:
    """Return the settings of earlier pictures, None without any."""
    settings = results.manifest.settings(STAGE)
    return settings if isinstance(settings, PictureSettings) else None
