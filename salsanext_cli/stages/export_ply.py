# SPDX-License-Identifier: MIT
"""Scans and results to coloured point clouds."""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import NoInputError, SalsanextError, UsageError
from salsanext_cli.formats.layout import ScanFile, find_outputs, output_path
from salsanext_cli.formats.ply import write_ply
from salsanext_cli.geometry.knn import KnnParameters
from salsanext_cli.report.colours import error_colours, label_colours, value_colours, value_range
from salsanext_cli.stages.batch import BatchOptions, Outcome, run_batch
from salsanext_cli.stages.clouds import UNCERTAINTY, Cloud, read_cloud
from salsanext_cli.stages.inputs import Choice, choose, space_of
from salsanext_cli.stages.networks import NetworkChoice
from salsanext_cli.stages.outputs import (
    claim,
    recorded_label_space,
    recorded_sensor,
    remember_sources,
    remembered_scans,
    stage_settings,
)
from salsanext_cli.stages.uncertainty import KINDS as SAMPLED
from salsanext_cli.stages.uncertainty import SAMPLES, uncertainty_of

CLASS_COLOURS = ("label", "truth", "error")
COLOURS = (*CLASS_COLOURS, "intensity", "range", "uncertainty", *UNCERTAINTY)
"""What points can be coloured by; "uncertainty" is the total, else the epistemic."""
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

    def __call__(self, file: ScanFile) -> None:
        """Read everything known, colour, write."""
        cloud = read_cloud(file, self.out, self.intensity_scale)
        columns = columns_of(cloud, self.space)
        require_column(columns, self.colour, file, self.out)
        colours = self._colours(cloud, columns)
        positions = dict(zip("xyz", cloud.scan.points.T, strict=True))
        channels = dict(zip(("red", "green", "blue"), colours.T, strict=True))
        comments = [f"colour {self._legend()}", f"label space {self.space.name}"]
        write_ply(self.results_of(file)[0], positions | channels | columns, comments)

    def _colours(self, cloud: Cloud, columns: dict[str, npt.NDArray[Any]]) -> npt.NDArray[np.uint8]:
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


def columns_of(cloud: Cloud, space: LabelSpace) -> dict[str, npt.NDArray[Any]]:
    """Return every scalar known about the points, by the name that its property gets."""
    columns: dict[str, npt.NDArray[Any]] = {
        "intensity": cloud.scan.intensity,
        "range": cloud.range,
    }
    if cloud.label is not None:
        columns["label"] = cloud.label.astype(np.uint16)
    if cloud.truth is not None:
        columns["truth"] = cloud.truth.astype(np.uint16)
        if cloud.label is not None:
            columns["error"] = cloud.error(space)
    return columns | cloud.uncertainty


def require_column(
    columns: dict[str, npt.NDArray[Any]], colour: str, file: ScanFile, out: Path
) -> None:
    """Raise `NoInputError` if what a scan should be coloured by is not known."""
    if colour not in columns:
        missing = {"truth": "labels", "error": "labels and predictions"}.get(colour, colour)
        stage = "predict" if colour in CLASS_COLOURS else "uncertainty"
        remedy = f"run `salsanext {stage}` with the output folder {out} first"
        raise NoInputError(file.path, f"no {missing} known", "some to colour by", remedy)


def export_ply(
    out: Path,
    *,
    colour: str = "label",
    scale: tuple[float, float] | None = None,
    dataset: Path | None = None,
    space: LabelSpace | None = None,
    network: NetworkChoice = NetworkChoice(),
    choice: Choice = Choice(),
    options: BatchOptions = BatchOptions(),
) -> Outcome[None]:
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
    space : LabelSpace, optional
        Otherwise the one that `predict` recorded in `out`, else that of the scans' data set.
    network : NetworkChoice
        What to sample scans with whose uncertainty is asked for but was not computed yet.
    choice, options
        Which scans, and how to go through them.

    Raises
    ------
    SalsanextError
        If nothing can be done at all; failures of single scans are in the outcome.
    """
    if colour not in COLOURS:
        raise UsageError("--colour", colour, f"one of {', '.join(COLOURS)}")
    colour = resolve_colour(out, colour)
    scans = remembered_scans(out, dataset)
    space = space or recorded_label_space(out) or space_of(scans)
    scans = with_results(out, choose(scans, Choice(choice.split, choice.sequences), space, out))
    scans = scans[: choice.limit]
    if colour in SAMPLED:
        _sample_missing(out, scans, colour, network, options)
    intensity_scale = recorded_sensor(out).intensity_scale
    if scale is None:
        scale = _recorded_scale(out, colour, options) or _scale(
            out, scans, colour, space, intensity_scale
        )
    settings = {"colour": colour, "scale": list(scale), "label_space": space.to_dict()}
    claim(out, "export-ply", settings, ("ply",), overwrite=options.overwrite)
    remember_sources(out, scans)
    work = ExportScan(out, space, intensity_scale, colour, scale)
    return run_batch(work, scans, options, work.results_of)


def _sample_missing(
    out: Path, scans: list[ScanFile], colour: str, network: NetworkChoice, options: BatchOptions
) -> None:
    """Sample the scans that lack an uncertainty, as the others in the folder were sampled."""
    folder = f"uncertainty/{colour}"
    missing = [s for s in scans if not output_path(out, s.sequence, folder, s.stem).exists()]
    if not missing:
        return
    _require_same_weights(out, network)
    earlier = stage_settings(out, "uncertainty") or {}
    samples = earlier.get("samples", SAMPLES)
    log.warning("no uncertainty of %d scans yet: sampling %d passes each", len(missing), samples)
    knn = KnnParameters(**earlier.get("knn", {}))
    seed = earlier.get("seed", 0)
    again = replace(options, overwrite=False)
    uncertainty_of(missing, out, network, again, knn=knn, samples=samples, seed=seed)


def _require_same_weights(out: Path, network: NetworkChoice) -> None:
    recorded = (stage_settings(out, "predict") or {}).get("weights")
    if recorded not in (None, network.settings()["weights"]):
        raise UsageError(
            out,
            f"labels by the weights {recorded[:12]}… and no uncertainty yet",
            "the same weights",
            "give them with --weights, or run `salsanext uncertainty`",
        )


def resolve_colour(out: Path, colour: str) -> str:
    """Say which kind "uncertainty" means here: the total if it was computed, else the epistemic."""
    if colour != "uncertainty":
        return colour
    return "total" if find_outputs(out, "uncertainty/total") else "epistemic"


def with_results(out: Path, scans: list[ScanFile]) -> list[ScanFile]:
    """Leave out the scans for which no stage has left a result."""
    folders = ("predictions", *(f"uncertainty/{kind}" for kind in UNCERTAINTY))
    known = {(f.sequence, f.stem) for folder in folders for f in find_outputs(out, folder)}
    chosen = [scan for scan in scans if (scan.sequence, scan.stem) in known]
    if not chosen:
        remedy = f"run `salsanext predict SCANS {out}` first"
        raise NoInputError(out, "no results of these scans", remedy=remedy)
    return chosen


def _recorded_scale(out: Path, colour: str, options: BatchOptions) -> tuple[float, float] | None:
    """Keep the scale of an earlier run, so that a run that goes on colours alike."""
    settings = stage_settings(out, "export-ply") or {}
    if options.overwrite or settings.get("colour") != colour:
        return None
    low, high = settings["scale"]
    return float(low), float(high)


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
            values.append(columns_of(read_cloud(file, out, intensity_scale), space)[colour])
    return value_range(np.concatenate(values))
