# SPDX-License-Identifier: MIT
"""Data of a page for its scripts."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.measures.counts import ScanCounts
from salsanext_cli.core.measures.scores import Counts
from salsanext_cli.report.colours import COLOUR_MAP, NOT_JUDGED, WRONG, Colours, map_colours
from salsanext_cli.report.page.clouds import NO_VALUE
from salsanext_cli.report.page.confusions import cells_of
from salsanext_cli.report.page.drive_data import drive_data
from salsanext_cli.report.page.mean_uncertainty import TITLES
from salsanext_cli.report.page.run_results import UNCERTAIN, RunResults
from salsanext_cli.runs.results.output_paths import find_outputs

OUTCOME_COLOURS = {"not judged": NOT_JUDGED, "right": (125, 133, 145), "wrong": WRONG}
"""Colours of points by outcome, which differ more than those of pictures."""
DARKEST_STEP = 48  # First step, of 255, of the colour map: lower ones are hard to see


def script_data(
    run: RunResults,
    class_points: Counts,
    colours: Colours,
    offered: Mapping[str, str],
    thumbnails: Mapping[str, str],
) -> dict[str, object]:
    """Return the numbers of the scans, and the colours, for the scripts of a page.

    Parameters
    ----------
    run : RunResults
        Numbers of all scans.
    class_points : ndarray of int64 (S, C)
        Number of points of each scan by predicted train id.
    colours : ndarray of uint8 (C, 3)
        Red, green and blue of each class.
    offered : mapping of str to str
        Names of the scans that the page can show, and why to look at them.
    thumbnails : mapping of str to str
        Pictures of some scans, as addresses for `img`, by name.

    Returns
    -------
    dict of str to object
        Plain data.
    """
    names = list(offered)
    return {
        **_palette(run.reader.space, colours),
        "boxes": bool(find_outputs(run.reader.out, "objects")),
        "uncertain": list(UNCERTAIN),
        "titles": TITLES,
        "shown": [{"name": name, "reason": reason} for name, reason in offered.items()],
        "drive": drive_data(run, class_points, names, thumbnails),
        "cells": cells_of(run.rows, names) if run.counts else {},
        "occurring": _occurring(class_points, run.counts),
    }


def _palette(space: LabelSpace, colours: Colours) -> dict[str, object]:
    """Return the colours of classes, outcomes and values, as plain data."""
    steps = np.linspace(DARKEST_STEP, 255, NO_VALUE)  # Of the colours of the values 0 to 254
    classes = zip(space.names, colours.tolist(), strict=True)
    return {
        "classes": [{"name": name, "rgb": rgb} for name, rgb in classes],
        "outcomes": [{"name": name, "rgb": rgb} for name, rgb in OUTCOME_COLOURS.items()],
        "map": map_colours(COLOUR_MAP)[steps.astype(np.intp)].ravel().tolist(),
    }


def _occurring(class_points: Counts, counts: ScanCounts | None) -> dict[str, list[int]]:
    """Return the classes in any scan, by colour: all scans have the same legend."""
    true = counts.confusion.sum(axis=1) if counts else ()
    points = {"label": class_points.sum(axis=0), "truth": true, "wrong": np.ones(3)}
    return {name: np.flatnonzero(counts).tolist() for name, counts in points.items()}
