# SPDX-License-Identifier: MIT
"""Scans and results to coloured point clouds."""

from __future__ import annotations

import logging
import math
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import OutputError, SalsanextError, UsageError
from salsanext_cli.formats.reading import filled, present
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.parallel.run import Failure, Outcome, RunOptions, run_over_scans
from salsanext_cli.report.colours import error_colours, label_colours, value_colours, value_range
from salsanext_cli.stages.late_uncertainty import estimate_missing
from salsanext_cli.storage.layout import ScanFile, find_outputs, output_path
from salsanext_cli.storage.missing import Absent, without_results
from salsanext_cli.storage.output_run import claimed
from salsanext_cli.storage.point_files import write_ply
from salsanext_cli.storage.predictions import space_of_results
from salsanext_cli.storage.scan_results import (
    UNCERTAINTY,
    ScanResults,
    read_results,
    scalar_columns,
    unknown,
    with_results,
)
from salsanext_cli.storage.selection import ScanSelection, choose
from salsanext_cli.storage.sources import remembered_scans
from salsanext_cli.storage.stage_records import (
    origins,
    recorded_sensor,
    recorded_weights,
    stage_settings,
)

CLASS_COLOURS = ("label", "truth", "error")
COLOURS = (*CLASS_COLOURS, "intensity", "range", "uncertainty", *UNCERTAINTY)
"""What points can be coloured by; "uncertainty" is the total, else the epistemic."""
STAGES_READ = ("predict", "knn-refine", "uncertainty")
COLOUR_MAP = "viridis"
SCANS_FOR_SCALE = 20

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ExportScan:
    """Write one scan as a coloured cloud."""

    out: Path
    space: LabelSpace
    intensity_scale: float
    colour: str
    scale: tuple[float, float]

    def results_of(self, file: ScanFile) -> list[Path]:
        """Return the file that is written for a scan."""
        return [output_path(self.out, file.sequence, "ply", file.stem)]

    def is_done(self, file: ScanFile) -> bool:
        """Whether a scan has all its results."""
        return all(filled(path) for path in self.results_of(file))

    def __call__(self, file: ScanFile) -> None:
        """Read everything known, colour, write."""
        cloud = read_results(file, self.out, self.intensity_scale)
        columns = scalar_columns(cloud, self.space)
        if self.colour not in columns:
            raise unknown(self.colour, file, self.out)
        colours = self._colours(cloud, columns)
        positions = dict(zip("xyz", cloud.scan.points.T, strict=True))
        channels = dict(zip(("red", "green", "blue"), colours.T, strict=True))
        comments = [f"colour {self._legend()}", f"label space {self.space.name}"]
        write_ply(self.results_of(file)[0], positions | channels | columns, comments)

    def _colours(
        self, cloud: ScanResults, columns: dict[str, npt.NDArray[Any]]
    ) -> npt.NDArray[np.uint8]:
        if self.colour not in CLASS_COLOURS:
            return value_colours(columns[self.colour], *self.scale, COLOUR_MAP)
        ids = {
            name: self.space.to_train(raw, strict=False)
            for name, raw in (("label", cloud.label), ("truth", cloud.truth))
            if raw is not None
        }
        if self.colour == "error":
            return error_colours(ids["truth"], ids["label"], self.space)
        return label_colours(ids[self.colour], self.space)

    def _legend(self) -> str:
        if self.colour in CLASS_COLOURS:
            return self.colour
        low, high = self.scale
        return f"{self.colour} {COLOUR_MAP} {low:.6g} {high:.6g}"


@dataclass(frozen=True, slots=True)
class Exported(Outcome[None]):
    """What became of the scans, and which of them have no results to show."""

    absent: Absent = field(default_factory=Absent)


def export_ply(
    out: Path,
    *,
    colour: str = "label",
    scale: tuple[float, float] | None = None,
    dataset: Path | None = None,
    usual_dataset: Path = Path(),
    space: LabelSpace | None = None,
    network: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Exported:
    """Write `OUT/sequences/<seq>/ply/*.ply`: positions, colours and every known scalar.

    Parameters
    ----------
    out : Path
        The output folder, with what earlier stages left there.
    colour : str
        One of `COLOURS`.
    scale : pair of float, optional
        The values at the ends of the colour map, for colours that are values. Otherwise what
        most points of the first scans span; it is the same for all scans and written down in
        every file.
    dataset : Path, optional
        Where the scans and labels are, if not where the scans came from.
    usual_dataset : Path
        Where to look for scans of which nobody recorded where they came from.
    space : LabelSpace, optional
        Otherwise the one that `predict` recorded in `out`, else that of the scans' data set.
    network : NetworkChoice
        What to sample scans with whose uncertainty is asked for but was not computed yet.
    selection, options
        Which scans, and how to go through them.

    Raises
    ------
    SalsanextError
        If nothing can be done at all; failures of single scans are in the outcome.
    """
    if colour not in COLOURS:
        raise UsageError("--colour", colour, f"one of {', '.join(COLOURS)}")
    if scale and not (scale[0] < scale[1] and all(map(math.isfinite, scale))):
        raise UsageError("--scale", f"{scale[0]} {scale[1]}", "a lower and a higher number")
    scans = remembered_scans(out, dataset, usual_dataset)
    space = space_of_results(out, scans, space)
    _require_same_weights(out)
    chosen = choose(scans, ScanSelection(selection.split, selection.sequences), space, out)
    scans = with_results(out, chosen)[: selection.limit]
    if len(scans) == selection.limit:
        # What comes after the last that is wanted is not looked at.
        chosen = chosen[: chosen.index(scans[-1]) + 1]
    absent = without_results(out, set(chosen) - set(scans))
    absent.complain(len(chosen), "results")
    unsampled: dict[ScanFile, Failure] = {}
    if colour in ("uncertainty", *UNCERTAINTY):
        colour, unsampled = estimate_missing(out, scans, colour, network, options)
    _require_some(out, scans, colour)
    intensity_scale = recorded_sensor(out).intensity_scale
    if scale is None:
        scale = _recorded_scale(out, colour, options) or _scale(
            out, scans, colour, space, intensity_scale
        )
    settings = {
        "colour": colour,
        "scale": list(scale),
        "label_space": space.to_dict(),
        "origins": origins(out, STAGES_READ),
    }
    work = ExportScan(out, space, intensity_scale, colour, scale)
    with claimed(out, "export-ply", settings, ("ply",), overwrite=options.overwrite):
        outcome = run_over_scans(work, scans, options, is_done=work.is_done)
    failures = tuple(unsampled.get(failure.scan, failure) for failure in outcome.failures)
    return Exported(outcome.results, outcome.skipped, failures, absent=absent)


def _require_same_weights(out: Path) -> None:
    """Refuse to show the uncertainty of one network beside the labels of another."""
    labels, doubts = (
        recorded_weights(out, folder) for folder in ("predictions", "uncertainty/epistemic")
    )
    if labels and doubts and labels != doubts:
        raise OutputError(
            out,
            f"labels by the weights {labels[:12]}…, uncertainty by {doubts[:12]}…",
            "the same weights for both",
            "run `salsanext uncertainty --overwrite` with the weights of the labels",
        )


def _require_some(out: Path, scans: list[ScanFile], colour: str) -> None:
    """Refuse at once what every scan would refuse for itself."""
    if colour in ("truth", "error"):
        known = any(present(scan.label_path) for scan in scans)
    else:
        known = colour not in UNCERTAINTY or bool(find_outputs(out, f"uncertainty/{colour}"))
    if not known:
        raise unknown(colour, scans[0], out)


def _recorded_scale(out: Path, colour: str, options: RunOptions) -> tuple[float, float] | None:
    """Keep the scale of an earlier run, so that a run that goes on colours alike."""
    settings = stage_settings(out, "export-ply")
    if options.overwrite or settings is None or settings["colour"] != colour:
        return None
    return settings.pair("scale")


def _scale(
    out: Path, scans: list[ScanFile], colour: str, space: LabelSpace, intensity_scale: float
) -> tuple[float, float]:
    """Find what most points of some evenly spaced scans span."""
    if colour in CLASS_COLOURS:
        return 0.0, 1.0
    step = -(-len(scans) // SCANS_FOR_SCALE)
    values: list[npt.NDArray[Any]] = [np.empty(0, np.float32)]
    for file in scans[::step]:
        # A scan that cannot be read is named when its turn comes.
        with suppress(SalsanextError):
            columns = scalar_columns(read_results(file, out, intensity_scale), space)
            values.append(columns.get(colour, values[0]))
    return value_range(np.concatenate(values))
