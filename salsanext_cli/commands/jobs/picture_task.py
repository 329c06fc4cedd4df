# SPDX-License-Identifier: MIT
"""Task that draws scans, and the scales that all pictures of a run share."""

import logging
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import with_hint
from salsanext_cli.core.wording import argument
from salsanext_cli.report.colours import (
    CLASS_COLOURS,
    Scale,
    Scales,
    common_scales,
    require_colouring,
)
from salsanext_cli.report.scan_pictures import (
    columns_from_above,
    columns_of_strips,
    picture_of_results,
)
from salsanext_cli.runs.records.stage_settings import PictureSettings
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.results.scan_results import PICTURE_COLOURS, picture_columns
from salsanext_cli.runs.scans.scan_file import ScanFile

FOLDER = "pictures"
LEAST_INSIDE = 0.5  # Share of the values of scans that a scale should contain
LEAST_USED = 0.1  # Share of a scale that they should use

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureScales:
    """Scales of the pictures of a run by colour, and what its scans contain."""

    used: Scales  # Values at equal steps along the colour map
    ranges: Scales  # Ends of the values of the scans to draw; their fixed scale if there is one


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureTask:
    """Task that draws a scan in some colours, or in all colours that it has."""

    colours: Sequence[str]  # Empty for all
    scales: Scales
    space: LabelSpace  # Classes of the labels in the pictures
    sensor: Sensor
    output: OutputRun
    classes: LabelSpace | None  # Classes into which predicted ones are merged
    truth_in: tuple[LabelSpace, LabelSpace] | None  # As of `ResultFolder.read`

    def __call__(self, file: ScanFile) -> None:
        """Write the picture of a scan."""
        self.output.require_replaceable(file)
        folder = ResultFolder(self.output.root)
        results = folder.read(file, self.sensor, self.classes, self.truth_in)
        columns = picture_columns(results, self.space)
        for colour in self.colours:
            if colour not in columns:
                raise folder.missing_column(colour, file)
        png = picture_of_results(
            file.name,
            results,
            self.space,
            self.sensor,
            self.scales,
            self.colours or columns_from_above(columns),
            self.colours or columns_of_strips(columns),
        )
        self.output.write(self.output.path(file, FOLDER), png)


def require_drawable(colours: Collection[str], scale: tuple[float, float] | None) -> None:
    """Refuse unknown colours, and a scale for anything but a single colour of values."""
    require_colouring(colours, scale, "colours", possible=PICTURE_COLOURS)
    if scale and (len(colours) != 1 or {*colours} & {*CLASS_COLOURS}):
        problem = f"{argument('colours')} is {', '.join(colours) or 'missing'}"
        raise UsageError(argument("scale"), problem, "a single colour of values, such as error")


def drawn_colours(
    results: ResultFolder, scans: Sequence[ScanFile], colours: Collection[str]
) -> list[str]:
    """Return each colour once, with a kind of uncertainty for "uncertainty"; refuse absent ones."""
    kind = results.default_uncertainty(scans)
    drawn = dict.fromkeys(kind if colour == "uncertainty" else colour for colour in colours)
    for colour in drawn:
        results.require_column(colour, scans)
    return list(drawn)


def picture_scales(
    results: ResultFolder,
    scans: Sequence[ScanFile],
    colours: Sequence[str],
    *,
    scale: tuple[float, float] | None,
    continued: PictureSettings | None,
    space: LabelSpace,
    sensor: Sensor,
) -> PictureScales:
    """Return the scale of each colour of values: requested, as recorded, or common to all scans.

    Parameters
    ----------
    results : ResultFolder
        Folder of the pictures, and of results of the scans.
    scans : sequence of ScanFile
        Scans to draw.
    colours : sequence of str
        Colours that the pictures may have.
    scale : tuple of float, optional
        Ends of the scale of the only colour.
    continued : PictureSettings, optional
        Settings of the pictures that are continued, whose scales stay.
    space : LabelSpace
        Classes of the labels.
    sensor : Sensor
        Sensor of the range images.

    Returns
    -------
    PictureScales
    """
    values = [
        colour
        for colour in colours
        if colour not in CLASS_COLOURS and results.with_column(colour, scans)
    ]
    ranges = common_scales(results.root, scans, values, space, sensor)
    # A value that does not vary has no scale yet: pictures of other scans may need one.
    used = {colour: ends for colour, ends in ranges.items() if ends[0] < ends[-1]}
    if scale is not None:
        used = dict.fromkeys(colours, scale)
    elif continued is not None:
        used |= continued.scales or {}
    return PictureScales(used=used, ranges=ranges)


def warn_of_unfit_scales(out: Path, scales: PictureScales) -> None:
    """Warn of scans whose values the scales of earlier pictures hardly show.

    Parameters
    ----------
    out : Path
        Folder of the pictures.
    scales : PictureScales
        Scales of the earlier pictures, and the ranges of the values of the scans.
    """
    for colour, scale in scales.used.items():
        values = scales.ranges.get(colour, scale)
        if values[0] < values[-1] and not _fits(scale, values):
            text = f"{colour} of these scans is {values[0]:.3g} to {values[-1]:.3g}"
            problem = f"{text}, the earlier pictures have {scale[0]:.3g} to {scale[-1]:.3g}"
            log.warning("%s", with_hint(f"{out}: {problem}", "draw them into another folder"))


def _fits(scale: Scale, values: Scale) -> bool:
    """Return whether a scale contains half of the span of values, and they use a tenth of it."""
    span = values[-1] - values[0]
    common = max(0.0, min(scale[-1], values[-1]) - max(scale[0], values[0]))
    is_inside = common >= LEAST_INSIDE * span
    return is_inside and span >= LEAST_USED * (scale[-1] - scale[0])
