# SPDX-License-Identifier: MIT
"""Predictions in an output folder: their scans, their label space and their provenance."""

import logging
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import LabelError, first_few
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.storage.selection import ScanSelection, choose, space_of
from salsanext_cli.storage.sources import recorded_scans
from salsanext_cli.storage.stage_records import (
    origins,
    owner,
    recorded_label_space,
    recorded_weights,
    stage_settings,
)

log = logging.getLogger(__name__)

UNCERTAINTY_SETTINGS = ("method", "samples", "seed", "noise", "weights")
"""Settings of `uncertainty` that an evaluation records."""


def predicted_scans(
    out: Path,
    selection: ScanSelection,
    dataset: Path | None = None,
    space: LabelSpace | None = None,
) -> tuple[list[ScanFile], LabelSpace]:
    """Find the scans whose predictions an output folder holds, and the label space of both.

    Parameters
    ----------
    out : Path
        Output folder of `predict` or `knn-refine`.
    selection : ScanSelection
        Which of them.
    dataset : Path, optional
        Where the scans and labels are, if not where the scans came from.
    space : LabelSpace, optional
        Otherwise that of the scans' data set, else the one recorded in `out`.

    Raises
    ------
    NoInputError
        If there are none.
    LabelError
        If predictions and labels speak of different classes.
    """
    scans = recorded_scans(out, dataset)
    space = space_of_results(out, scans, space)
    chosen = choose(scans, selection, space, out)
    if selection.split:
        members = set(space.split(selection.split))
        found = {scan.sequence for scan in chosen}
        if absent := sorted(members - found if members & found else ()):
            log.warning("no predictions for %s of split %s", ", ".join(absent), selection.split)
    return chosen, space


def space_of_results(
    out: Path, scans: list[ScanFile], space: LabelSpace | None = None
) -> LabelSpace:
    """Return the classes of scans and of the predictions for them, if they are the same ones.

    Raises
    ------
    LabelError
        If predictions and labels speak of different classes.
    """
    recorded = recorded_label_space(out)
    space = space or space_of(scans, recorded)
    if recorded is not None and not recorded.fits(space):
        raise LabelError(
            out,
            f"predictions in the classes of {recorded.name} "
            f"({first_few(recorded.differences(space))})",
            f"those of {space.name}, as the labels",
            "predict with weights for these classes",
        )
    return space


def provenance(out: Path, selection: ScanSelection, dataset: Path | None = None) -> dict[str, Any]:
    """Return, as plain data, what was chosen and which stage and weights made the predictions."""
    stage = owner(out, "predictions")
    softmax: Mapping[str, Any] = stage_settings(out, "predict") or {}
    estimated = stage_settings(out, "uncertainty")
    made_by = sorted({*([stage] if stage else []), *(["uncertainty"] if estimated else [])})
    kept = {
        "dataset": str(dataset.absolute()) if dataset else None,
        "predictions_of": stage,
        "weights": recorded_weights(out, "predictions"),
        "temperature": softmax.get("temperature"),
        "uncertainty": {key: estimated[key] for key in UNCERTAINTY_SETTINGS if key in estimated}
        if estimated
        else None,
        "origins": origins(out, made_by),
    }
    return asdict(selection) | kept
