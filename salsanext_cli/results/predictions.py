# SPDX-License-Identifier: MIT
"""Predictions in an output folder: their scans, their label space and their provenance."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.classes.merging import ClassMerging, contradiction
from salsanext_cli.errors import LabelError, OutputError, first_few
from salsanext_cli.options import ScanSelection
from salsanext_cli.records import Float
from salsanext_cli.results.layout import ERROR, ScanFile
from salsanext_cli.results.selection import choose, data_set_of, space_of, with_splits
from salsanext_cli.results.sources import recorded_scans
from salsanext_cli.results.stage_records import (
    origins,
    owner,
    recorded_label_space,
    recorded_weights,
    settings_of,
    stage_settings,
)

UNCERTAINTY_SETTINGS = ("method", "samples", "seed", "noise", "weights")
"""Settings of `uncertainty` that an evaluation records."""

log = logging.getLogger(__name__)


def rejected_above(out: Path) -> float | None:
    """Return the error above which the points in a folder were left unlabelled; None if none."""
    settings = settings_of(out, "predictions")
    return None if settings is None else settings.get("reject")


def rejected_points(out: Path, error: Float) -> npt.NDArray[np.bool_]:
    """Say of points, by their error (N,), which were left unlabelled for it."""
    above = rejected_above(out)
    return np.zeros(len(error), bool) if above is None else error > above


def predicted_scans(
    out: Path,
    selection: ScanSelection,
    dataset: Path | None = None,
    space: LabelSpace | None = None,
    classes: LabelSpace | None = None,
) -> tuple[list[ScanFile], LabelSpace]:
    """Find the scans whose predictions an output folder holds, and the classes to compare.

    `out`: output folder of `predict` or `knn-refine`; `selection`: which of them; `dataset`: where
    the scans and labels are, if not where the scans came from; `space`: of the labels; otherwise
    that of the scans' data set, else the one recorded in `out`; `classes`: into whose classes those
    of labels and predictions are merged.
    """
    scans = recorded_scans(out, dataset)
    space = space_of_results(out, scans, space, classes, own_ids=True)
    if selection.split:
        space = with_splits(space, data_set_of(scans[0]))
    chosen = choose(scans, selection, space, out)
    if selection.split:
        members = set(space.split(selection.split))
        found = {scan.sequence for scan in chosen}
        if absent := sorted(members - found if members & found else ()):
            log.warning("no predictions for %s of split %s", ", ".join(absent), selection.split)
    return chosen, space


def space_of_results(
    out: Path,
    scans: list[ScanFile],
    space: LabelSpace | None = None,
    classes: LabelSpace | None = None,
    *,
    own_ids: bool = False,
) -> LabelSpace:
    """Return the classes in which predictions and labels are compared.

    They are those of both, or those of the predictions where these are merged ones of the labels',
    or those that both are to be merged into. The splits are those of the labels; there may be
    none, as `selection.with_splits` mends.

    `out`, `space`, `classes`: as for `predicted_scans`; `scans`: all scans of the predictions;
    `own_ids`: whether labels may have raw ids of their own for classes of the same names.
    """
    recorded = recorded_label_space(out)
    space = space or space_of(scans, recorded)
    target = classes or recorded or space
    named_alike = own_ids and space.names == target.names
    if classes is not None:
        for own in (recorded or space, *(() if named_alike else (space,))):
            ClassMerging.needed(own, classes)
    elif target.fits(space):
        return space
    elif not named_alike and contradiction(space, target):
        raise LabelError(
            out,
            f"predictions in the classes of {target.name} ({first_few(target.differences(space))})",
            f"those of {space.name}, as the labels",
            "predict with weights for these classes, or merge both with --classes",
        )
    return replace(target, splits=space.splits or (classes or space).splits)


def space_of_labels(
    scans: Sequence[ScanFile], space: LabelSpace, labels: LabelSpace | None = None
) -> LabelSpace:
    """Return the meaning of the raw ids of labels that are compared in the classes of a space.

    Labels may have their own for classes of the same names; `labels` is their label space, if it is
    not that of the scans' data set.
    """
    own = labels or space_of(scans, space)
    return own if own.names == space.names else space


def merging_into(out: Path, space: LabelSpace) -> ClassMerging | None:
    """Return the merging of the classes of the probabilities in a folder into others, if needed.

    Probabilities of unknown origin are those of the other classes.
    """
    recorded = recorded_label_space(out, "probabilities")
    return (
        None if recorded is None or recorded.fits(space) else ClassMerging.between(recorded, space)
    )


def require_same_weights(out: Path) -> None:
    """Refuse to show the uncertainty of one network, or in other classes, beside the labels."""
    labels, space = recorded_weights(out, "predictions"), recorded_label_space(out, "predictions")
    remedy = f"run `salsanext uncertainty SCANS {out} --overwrite` with the"
    for folder in ("uncertainty/epistemic", ERROR):
        estimated, other = recorded_weights(out, folder), recorded_label_space(out, folder)
        if labels and estimated and labels != estimated:
            raise OutputError(
                out,
                f"labels by the weights {labels[:12]}…, uncertainty by {estimated[:12]}…",
                "the same weights for both",
                f"{remedy} weights of the labels",
            )
        if labels and space and other and not space.fits(other):
            raise OutputError(
                out,
                f"labels in the classes of {space.name}, uncertainty in those of {other.name}",
                "the same for both",
                f"{remedy} --classes of the labels",
            )


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
        "reject": rejected_above(out),
        "uncertainty": {key: estimated[key] for key in UNCERTAINTY_SETTINGS if key in estimated}
        if estimated
        else None,
        "origins": origins(out, made_by),
    }
    return asdict(selection) | kept
