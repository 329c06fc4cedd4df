# SPDX-License-Identifier: MIT
"""Content of the page of a run, from the numbers of its scans and the clouds to show."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import counted, escaped
from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.measures.drive import ScanRow, leading_kind
from salsanext_cli.measures.scan_counts import RING_NAMES, ScanCounts
from salsanext_cli.measures.scores import Scores, scores
from salsanext_cli.measures.uncertainty_evaluation import (
    UncertaintyEvaluation,
    evaluate_uncertainty,
)
from salsanext_cli.report.colours import COLOUR_MAP, WRONG, Colours, map_colours, screen_colours
from salsanext_cli.report.page.clouds import (
    NO_VALUE,
    base64_of,
    encode_cloud,
    plain_scales,
)
from salsanext_cli.report.page.html import ClassShare, PageContent
from salsanext_cli.report.page.shown_scans import UNCERTAIN, ShownScan
from salsanext_cli.report.plots import uncertainty_pictures
from salsanext_cli.report.tables import percent
from salsanext_cli.sensors.sensor import Sensor

OUTCOME_COLOURS = {"not judged": (62, 76, 150), "right": (125, 133, 145), "wrong": WRONG}
"""Farther apart than in other pictures, where what is not judged has the colour of nothing."""
DARKEST_STEP = 48
"""Step of the colour map, of 255, where its scale begins: those below are lost on a dark view."""


MAX_CONFUSIONS = 10
"""Confusions that the page names."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Comparison of the scans that have labels."""

    counts: ScanCounts  # Counts of their points
    scores: Scores  # Scores of the labels
    # Results for the probabilities and uncertainties, if there are any
    uncertainty: UncertaintyEvaluation

    @classmethod
    def of(cls, counts: ScanCounts, space: LabelSpace) -> Comparison:
        """Divide the counts."""
        uncertainty = evaluate_uncertainty(counts, space)
        return cls(counts, scores(counts.confusion, space), uncertainty)


def content_of(
    title: str,
    facts: Sequence[tuple[str, str]],
    warnings: Sequence[str],
    *,
    rows: Sequence[ScanRow],
    compared: Comparison | None,
    shown: Sequence[ShownScan],
    scales: Mapping[str, tuple[float, float]],
    space: LabelSpace,
    sensor: Sensor,
    served: Mapping[str, str] | None = None,
) -> PageContent:
    """Put a page together.

    `title`: name of the run; `facts`, `warnings`: as `facts_of_run` and `warnings_of_run` return
    them; `rows`: all scans, in their order; `compared`: of the scans with labels, if there are any;
    `shown`: scans to show point by point; `scales`: as `scales_of` returns them; `space`, `sensor`:
    classes and range image of the labels; `served`: scans whose points the page asks a server for,
    with the reason to look at them, which may be empty; otherwise it holds those of `shown`.
    """
    colours = screen_colours(space)
    offered = {scan.name: scan.reason for scan in shown} if served is None else served
    page = PageContent(
        title=title,
        tiles=_tiles(rows, compared),
        facts=facts,
        warnings=warnings,
        shares=_shares(rows, compared, space, colours),
        data=escaped(
            _data(rows, offered, scales, space, colours) | {"occurring": _occurring(rows, compared)}
        ),
        clouds=[escaped(encode_cloud(each, space, sensor, scales)) for each in shown],
        live=served is not None,
    )
    if compared is None:
        return page
    kept = compared.uncertainty.kept
    return replace(
        page,
        sentence=f"{kept.sentence[:1].upper()}{kept.sentence[1:]}." if kept else "",
        rings=_rings(compared.counts, space),
        confusions=_confusions(compared.counts.confusion, space),
        pictures=uncertainty_pictures(compared.uncertainty, space),
    )


def _tiles(rows: Sequence[ScanRow], compared: Comparison | None) -> list[tuple[str, str]]:
    points = sum(row.points for row in rows)
    tiles = [("scans", f"{len(rows):,}"), ("points", f"{points:,}")]
    if compared:
        found, scans = compared.scores, counted(compared.counts.scans, "scan")
        which = "trained on" if compared.counts.trained_on else "with labels"
        present = sum(each.points > 0 for each in found.classes)
        tiles += [
            (f"accuracy, {scans} {which}", percent(found.accuracy, 1, " %")),
            (f"mean IoU of {present} classes present", percent(found.iou_mean_present, 1, " %")),
        ]
        if present < len(found.classes):
            official = percent(found.iou_mean_official, 1, " %")
            tiles.append((f"mean IoU of all {len(found.classes)}, official", official))
    return tiles


def _shares(
    rows: Sequence[ScanRow], compared: Comparison | None, space: LabelSpace, colours: Colours
) -> list[ClassShare]:
    """Return every class that is predicted or in the truth; none without predictions."""
    points = np.zeros(space.class_count, np.int64)
    for row in rows:
        points += 0 if row.class_points is None else row.class_points
    if not points.any():
        return []
    judged = {each.train_id: each for each in (compared.scores.classes if compared else ())}
    shares = []
    for i, name in enumerate(space.names):
        score = judged.get(i)
        true = score.points if score else 0
        if points[i] or true:
            iou = score.iou if score and true else math.nan
            shares.append(ClassShare(name, colours[i].tolist(), points[i] / points.sum(), iou))
    return shares


def _confusions(confusion: Confusion, space: LabelSpace) -> list[str]:
    """Say what is taken for what, most points first."""
    matrix, names = confusion.counted(space.scored), space.names
    truths, wrong = matrix.sum(axis=1), np.where(np.eye(len(matrix), dtype=bool), 0, matrix)
    most = np.argsort(-wrong, axis=None, kind="stable")[:MAX_CONFUSIONS]
    return [
        f"{names[true]} taken for {names[predicted]}: "
        f"{percent(points / truths[true], 1, ' %')} of {counted(int(truths[true]), 'point')}"
        for true, predicted in zip(*np.unravel_index(most, wrong.shape), strict=True)
        if (points := wrong[true, predicted])
    ]


def _rings(counts: ScanCounts, space: LabelSpace) -> list[tuple[str, ...]]:
    """Return the scores of the rings of distance as text; none if they were not counted."""
    rows: list[tuple[str, ...]] = []
    for name, ring in zip(RING_NAMES, counts.rings, strict=bool(counts.rings)):
        found = scores(ring, space)
        shares = percent(found.iou_mean_present), percent(found.accuracy)
        if found.points:
            rows.append((name, *shares, f"{found.points:,}"))
    return rows


def _data(
    rows: Sequence[ScanRow],
    offered: Mapping[str, str],
    scales: Mapping[str, tuple[float, float]],
    space: LabelSpace,
    colours: Colours,
) -> dict[str, Any]:
    """Return what the scripts of the page need besides the clouds, as plain data."""
    steps = np.linspace(DARKEST_STEP, 255, NO_VALUE)
    return {
        "classes": [
            {"name": name, "rgb": rgb}
            for name, rgb in zip(space.names, colours.tolist(), strict=True)
        ],
        "outcomes": [{"name": name, "rgb": rgb} for name, rgb in OUTCOME_COLOURS.items()],
        "scales": plain_scales(scales),
        "uncertain": list(UNCERTAIN),
        "map": map_colours(COLOUR_MAP)[steps.astype(np.intp)].ravel().tolist(),
        "shown": [{"name": name, "reason": reason} for name, reason in offered.items()],
        "drive": _drive(rows, list(offered)),
    }


def _occurring(rows: Sequence[ScanRow], compared: Comparison | None) -> dict[str, list[int]]:
    """Return the classes of some scan, by colour: the legend is the same for all scans."""
    predicted = [row.class_points for row in rows if row.class_points is not None]
    true = compared.counts.confusion.matrix.sum(axis=1) if compared else ()
    found = {"label": np.sum(predicted, axis=0), "truth": true, "wrong": np.ones(3)}
    return {name: np.flatnonzero(points).tolist() for name, points in found.items()}


def _drive(rows: Sequence[ScanRow], shown: Sequence[str]) -> dict[str, Any]:
    """Return the numbers of all scans; base64 of float32, empty without any."""
    places = {name: place for place, name in enumerate(shown)}
    kind = leading_kind(rows)
    shares = None
    if any(row.class_points is not None for row in rows):
        empty = np.zeros(next(len(r.class_points) for r in rows if r.class_points is not None))
        points = np.array([empty if r.class_points is None else r.class_points for r in rows])
        shares = points / np.maximum(points.sum(axis=1, keepdims=True), 1)
    means = np.array([row.uncertainty.get(kind or "", np.nan) for row in rows])
    wrong = np.array([row.wrong for row in rows])
    known = {"uncertainty": means, "wrong": wrong, "shares": shares}
    return {
        "names": [row.name for row in rows],
        "shown": [places.get(row.name, -1) for row in rows],
        "kind": (kind or "").replace("_", " "),
    } | {
        name: "" if values is None or np.isnan(values).all() else base64_of(values, "<f4")
        for name, values in known.items()
    }
