# SPDX-License-Identifier: MIT
"""Stage `picture`: pictures of scans, with their results if there are any."""

import logging
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from salsanext_cli.commands.jobs.picture_task import (
    FOLDER,
    PictureScales,
    PictureTask,
    drawn_colours,
    picture_scales,
    require_drawable,
    warn_of_unfit_scales,
)
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.notices import NOTICE, demote_result_notices
from salsanext_cli.core.records import Origin
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.sensors import sensor as named_sensor
from salsanext_cli.report.colours import Scales
from salsanext_cli.runs.annotation.foreign_labels import warn_of_foreign_labels
from salsanext_cli.runs.fit.sensor_fit import fitted_view
from salsanext_cli.runs.fit.stated_origin import origin_in_frame
from salsanext_cli.runs.loop.recorded_names import with_recorded_names
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.records.stage_settings import PictureSettings
from salsanext_cli.runs.results.folder_names import COLOURINGS, PREDICTION_STAGES
from salsanext_cli.runs.results.output_run import OutputRun, output_run
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ChosenResults, ResultFolder
from salsanext_cli.runs.results.scan_results import HEIGHT
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import (
    MissingResults,
    choose,
    scans_of,
    space_of,
    space_of_labels,
)

STAGE: Final = "picture"

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureOutcome(Outcome):
    """Numbers of a run that drew scans, and what the pictures show."""

    sensor: Sensor  # Sensor of the range images
    scales: Scales  # Values at equal steps along the colour map, by colour
    ranges: Scales  # Ends of the values of the drawn scans, by colour
    first: Path  # Picture of the first scan that has one


def picture(
    out: Path,
    *,
    colours: Collection[str] = (),
    scale: tuple[float, float] | None = None,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> PictureOutcome:
    """Draw scans with results to `OUT/sequences/<seq>/pictures/*.png`.

    Parameters
    ----------
    out : Path
        Folder with results.
    colours : collection of str
        Some of `PICTURE_COLOURS`; by default every colour that a scan has.
    scale : tuple of float, optional
        Values at the ends of the colour map, for a single colour.
    query : ResultQuery, optional
        Choice of the scans, their data set and classes.
    options : RunOptions, optional
        Workers, progress, and treatment of failures and of existing results.

    Returns
    -------
    PictureOutcome
    """
    require_drawable(colours, scale)
    results = ResultFolder(out, query.dataset)
    chosen = results.chosen(query)
    run = PictureRun(
        results=results,
        chosen=chosen,
        colours=drawn_colours(results, chosen.scans, colours),
        scale=scale,
        query=query,
        options=options,
    )
    with demote_result_notices():
        sensor = run.recorded_sensor or fitted_view(chosen.scans, named_sensor("hdl64"))
    scales = run.scales(sensor, COLOURINGS)
    settings = run.settings(scales.used, sensor, chosen.space)
    return run.draw(settings, scales, sensor, record_scans=False)


def picture_scans(
    source: Path | Sequence[Path],
    out: Path,
    *,
    colours: Collection[str] = (),
    scale: tuple[float, float] | None = None,
    settings: NetworkSettings = NetworkSettings(),
    origin: Origin | None = None,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> PictureOutcome:
    """Draw scans, which need no results, to `OUT/sequences/<seq>/pictures/*.png`.

    All pictures of a folder have the same scales, so that they can be compared. The scale of a
    value is recorded when the value first varies. Scans with other values get a warning. Each call
    has a sensor of its own, so the record contains only a requested one.

    Parameters
    ----------
    source : Path or sequence of Path
        Scan files, a folder of scans, a sequence, a data set or a recording.
    out : Path
        Output folder. Its results of the same scans are drawn too.
    colours : collection of str
        Some of `PICTURE_COLOURS`; by default height, intensity and range, or the results.
    scale : tuple of float, optional
        Values at the ends of the colour map, for a single colour.
    settings : NetworkSettings, optional
        Sensor of the scans, as `predict` takes it; no network is loaded.
    origin : 3 floats, optional
        Position of the sensor in the coordinates of the files, in metres.
    query : ResultQuery, optional
        Choice of the scans, and their classes.
    options : RunOptions, optional
        Workers, progress, and treatment of failures and of existing results.

    Returns
    -------
    PictureOutcome
    """
    require_drawable(colours, scale)
    listed = with_recorded_names(scans_of(source), out)
    requested_space = query.classes or query.label_space
    space = requested_space or space_of(listed)
    scans = choose(listed, query.selection, space, source)
    results = ResultFolder(out)
    run = PictureRun(
        results=results,
        chosen=ChosenResults(
            listed=listed,
            scans=scans,
            space=space,
            labels=space_of_labels(listed, space, query.label_space),
            missing=MissingResults(),
        ),
        colours=drawn_colours(results, scans, colours),
        scale=scale,
        query=query,
        options=options,
    )
    if origin is not None:
        reader = settings.named_sensor() or settings.trained_sensor()
        settings = replace(settings, origin=origin_in_frame(origin, listed, reader))
    requested = settings.named_sensor()
    with demote_result_notices():
        sensor = fitted_view(
            listed,
            requested or settings.trained_sensor(),
            None if requested else results.provenance.recorded_sensor(),
            view=settings.fits_view,
            mounting=settings.fits_mounting,
        )
    scales = run.scales(sensor, (HEIGHT, *COLOURINGS))
    if run.continued is not None and scale is None:
        warn_of_unfit_scales(results.root, scales)
    recorded = run.settings(scales.used, requested, requested_space)
    return run.draw(recorded, scales, sensor, record_scans=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureRun:
    """Run that draws chosen scans."""

    results: ResultFolder  # Folder of the pictures, and of results of the scans
    chosen: ChosenResults
    colours: Sequence[str]  # Empty for all
    scale: tuple[float, float] | None  # Requested ends of the scale of the only colour
    query: ResultQuery
    options: RunOptions

    @property
    def earlier(self) -> PictureSettings | None:
        """Settings of earlier pictures, None without any."""
        settings = self.results.manifest.settings(STAGE)
        return settings if isinstance(settings, PictureSettings) else None

    @property
    def overwrite(self) -> bool:
        """Whether earlier pictures are replaced: on request, or if their results changed."""
        earlier = self.earlier
        is_outdated = earlier is not None and earlier.origins != self._origins()
        return self.options.overwrite or is_outdated

    @property
    def continued(self) -> PictureSettings | None:
        """Settings of the earlier pictures that this run continues, None without any."""
        return None if self.overwrite else self.earlier

    @property
    def recorded_sensor(self) -> Sensor | None:
        """Sensor of the results of the folder, else of the pictures that this run continues."""
        continued = self.continued
        return self.results.provenance.recorded_sensor() or (
            continued.sensor if continued else None
        )

    def _origins(self) -> dict[str, str]:
        return self.results.provenance.origins(PREDICTION_STAGES)

    def _to_do(self) -> list[ScanFile]:
        """Return the scans without a picture that this run continues."""
        if self.continued is None:
            return [*self.chosen.scans]
        earlier = OutputRun(self.results.root, STAGE, folders=(FOLDER,))
        return [scan for scan in self.chosen.scans if not earlier.is_done(scan)]

    def scales(self, sensor: Sensor, possible: Sequence[str]) -> PictureScales:
        """Return the scales of the pictures, as of `picture_scales`.

        `possible`: colours that the pictures may have if none was requested.
        """
        return picture_scales(
            self.results,
            self._to_do(),
            self.colours or possible,
            scale=self.scale,
            continued=self.continued,
            space=self.chosen.space,
            sensor=sensor,
        )

    def settings(
        self, scales: Scales, sensor: Sensor | None, space: LabelSpace | None
    ) -> PictureSettings:
        """Return the settings to record."""
        return PictureSettings(
            colours=tuple(self.colours),
            scales=scales,
            sensor=sensor,
            label_space=space,
            origins=self._origins(),
        )

    def draw(
        self,
        settings: PictureSettings,
        scales: PictureScales,
        sensor: Sensor,
        *,
        record_scans: bool,
    ) -> PictureOutcome:
        """Draw the scans.

        Parameters
        ----------
        settings : PictureSettings
            Settings to record.
        scales : PictureScales
            Scales of the pictures, and the ranges of the values of the scans.
        sensor : Sensor
            Sensor of the range images.
        record_scans : bool
            Whether to record where the scans are.
        """
        results = self.results
        chosen = self.chosen
        colours = self.colours
        run = output_run(
            results.root,
            STAGE,
            settings,
            (FOLDER,),
            chosen.scans,
            overwrite=self.overwrite,
            record_scans=record_scans,
        )
        draws_truth = _draws_truth(chosen, colours, sensor)
        with run as output:
            task = PictureTask(
                colours=colours,
                scales=scales.used,
                space=chosen.space,
                sensor=sensor,
                output=output,
                classes=self.query.classes,
                truth_in=(chosen.labels, chosen.space) if draws_truth else None,
            )
            outcome = run_over_scans(
                task, chosen.scans, self.options, is_done=output.is_done, writes=[self.results.root]
            )
            log.log(NOTICE, "pictures: %s", results.root / "sequences/*" / FOLDER)
        return PictureOutcome.from_run(
            replace(outcome, missing=chosen.missing),
            sensor=sensor,
            scales=scales.used,
            ranges=scales.ranges,
            first=_first_picture([output.path(scan, FOLDER) for scan in chosen.scans]),
        )


def _first_picture(paths: Sequence[Path]) -> Path:
    """Return the first picture that exists; the first path if none does."""
    return next((path for path in paths if path.exists()), paths[0])


def _draws_truth(chosen: ChosenResults, colours: Collection[str], sensor: Sensor) -> bool:
    """Return whether pictures need the true labels: if asked for, or if there are usable ones."""
    if colours:
        return bool({"truth", "wrong"} & {*colours})
    return not warn_of_foreign_labels(chosen.scans, chosen.labels, sensor)
