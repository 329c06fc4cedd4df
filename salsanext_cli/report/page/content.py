# SPDX-License-Identifier: MIT
"""Content of the page of a run, from the numbers of its scans and the clouds to show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import as_text, counted
from salsanext_cli.measures.drive import ScanRow, leading_kind
from salsanext_cli.measures.scan_counts import RING_NAMES, ScanCounts
from salsanext_cli.measures.scores import Scores, scores
from salsanext_cli.measures.uncertainty_evaluation import UncertaintyEvaluation
from salsanext_cli.report.colours import COLOUR_MAP, OUTCOMES, Colours, map_colours, on_dark
from salsanext_cli.report.evaluation_pictures import evaluation_pictures
from salsanext_cli.report.page.clouds import (
    NO_VALUE,
    UNCERTAIN,
    UNITS,
    ShownScan,
    base64_of,
    encode_cloud,
)
from salsanext_cli.report.page.html import PageContent
from salsanext_cli.report.tables import percent
from salsanext_cli.sensors import Sensor

OUTCOME_NAMES = ("not judged", "right", "wrong")


def content_of(
    title: str,
    facts: Sequence[tuple[str, str]],
    warnings: Sequence[str],
    rows: Sequence[ScanRow],
    counts: ScanCounts | None,
    uncertainty: UncertaintyEvaluation | None,
    shown: Sequence[ShownScan],
    scales: Mapping[str, tuple[float, float]],
    space: LabelSpace,
    sensor: Sensor,
) -> PageContent:
    """Put a page together.

    Parameters
    ----------
    title : str
        Name of the run.
    facts, warnings : sequences
        As `facts_of_run` and `warnings_of_run` return them.
    rows : sequence of ScanRow
        All scans, in their order.
    counts, uncertainty : ScanCounts and UncertaintyEvaluation, or None
        Counts of the labelled scans, and what follows from them; None without labels.
    shown : sequence of ShownScan
        Scans to show; scales as `scales_of` returns them.
    space, sensor
        Classes and range image of the labels.
    """
    found = scores(counts.confusion, space) if counts else None
    colours = on_dark(space.colours)
    return PageContent(
        title=title,
        tiles=_tiles(rows, counts, found),
        facts=facts,
        warnings=warnings,
        sentence=_sentence(uncertainty),
        shares=_shares(rows, found, space, colours),
        rings=_rings(counts, space) if counts else [],
        pictures=evaluation_pictures(found, counts.confusion, uncertainty, space)
        if found and counts and uncertainty
        else {},
        data=as_text(_data(rows, shown, scales, space, colours)),
        clouds=[as_text(encode_cloud(each, space, sensor, scales)) for each in shown],
    )


def _tiles(
    rows: Sequence[ScanRow], counts: ScanCounts | None, found: Scores | None
) -> list[tuple[str, str]]:
    points = sum(row.points for row in rows)
    tiles = [("scans", f"{len(rows):,}"), ("points", f"{points:,}")]
    if counts and found:
        present = sum(each.points > 0 for each in found.classes)
        tiles += [
            (
                f"accuracy, {counted(counts.scans, 'scan')} with labels",
                percent(found.accuracy, 1, " %"),
            ),
            (f"mean IoU of {present} classes present", percent(found.iou_mean_present, 1, " %")),
            (f"mean IoU of all {len(found.classes)}", percent(found.iou_mean_official, 1, " %")),
        ]
    return tiles


def _sentence(uncertainty: UncertaintyEvaluation | None) -> str:
    kept = uncertainty.kept if uncertainty else None
    return f"{kept.sentence[:1].upper()}{kept.sentence[1:]}." if kept else ""


def _shares(
    rows: Sequence[ScanRow], found: Scores | None, space: LabelSpace, colours: Colours
) -> list[tuple[str, tuple[int, int, int], float, str]]:
    """Return name, colour, share and IoU of every class that is predicted or in the truth."""
    points = np.zeros(space.class_count, np.int64)
    for row in rows:
        points += 0 if row.class_points is None else row.class_points
    iou = {each.train_id: percent(each.iou, 1, " %") for each in (found.classes if found else ())}
    in_truth = {each.train_id for each in (found.classes if found else ()) if each.points}
    listed = [i for i in range(space.class_count) if points[i] or i in in_truth]
    whole = max(int(points.sum()), 1)
    shares = []
    for i in listed if points.any() else []:
        red, green, blue = colours[i].tolist()
        shares.append((space.names[i], (red, green, blue), points[i] / whole, iou.get(i, "")))
    return shares


def _rings(counts: ScanCounts, space: LabelSpace) -> list[tuple[str, ...]]:
    """Return the scores of the rings of distance as text; none if they were not counted."""
    rows = []
    for name, ring in zip(RING_NAMES, counts.rings, strict=bool(counts.rings)):
        found = scores(ring, space)
        shares = percent(found.iou_mean_present), percent(found.accuracy)
        rows.append((name, *shares, f"{found.points:,}"))
    return rows


def _data(
    rows: Sequence[ScanRow],
    shown: Sequence[ShownScan],
    scales: Mapping[str, tuple[float, float]],
    space: LabelSpace,
    colours: Colours,
) -> dict[str, Any]:
    """Return what the scripts of the page need besides the clouds, as plain data."""
    outcomes = on_dark(OUTCOMES).tolist()
    return {
        "classes": [
            {"name": name, "rgb": rgb}
            for name, rgb in zip(space.names, colours.tolist(), strict=True)
        ],
        "outcomes": [
            {"name": name, "rgb": rgb} for name, rgb in zip(OUTCOME_NAMES, outcomes, strict=True)
        ],
        "scales": {
            name: {"low": low, "high": high, "unit": UNITS.get(name, "")}
            for name, (low, high) in scales.items()
        },
        "uncertain": list(UNCERTAIN),
        "map": map_colours(COLOUR_MAP)[:NO_VALUE].ravel().tolist(),
        "shown": [{"name": each.name, "reason": each.reason} for each in shown],
        "drive": _drive(rows, [each.name for each in shown]),
    }


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
