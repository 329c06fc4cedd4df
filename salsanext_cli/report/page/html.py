# SPDX-License-Identifier: MIT
"""Page of a run as one HTML file: a template filled with text, pictures and data."""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from string import Template

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import counted, escaped
from salsanext_cli.core.measures.counts import ScanCounts
from salsanext_cli.core.measures.scores import Counts
from salsanext_cli.report.colours import (
    COLOUR_MAP,
    NOT_JUDGED,
    WRONG,
    Colours,
    map_colours,
    screen_colours,
)
from salsanext_cli.report.page.clouds import NO_VALUE, Scale, encode_cloud
from salsanext_cli.report.page.confusions import cells_of, confusion_list, confusion_table
from salsanext_cli.report.page.drive_data import drive_data
from salsanext_cli.report.page.elements import bar, listed, script_data, text_of
from salsanext_cli.report.page.mean_uncertainty import TITLES
from salsanext_cli.report.page.overview import overview
from salsanext_cli.report.page.run_results import UNCERTAIN, Comparison, RunResults, ShownScan
from salsanext_cli.report.plots import PICTURES, uncertainty_pictures
from salsanext_cli.report.tables import percent
from salsanext_cli.runs.results.layouts import SCAN_FOLDER
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.paths import find_outputs
from salsanext_cli.version import __version__

PARTS = (
    "page.css",
    "camera.js",
    "view.js",
    "scales.js",
    "drive.js",
    "scans.js",
    "table.js",
    "page.js",
    "legend.js",
    "controls.js",
)
"""Files of this folder that the template includes, as $page_css and so on."""
FILE_WORDS = {
    "openable": "▾ marks the scans of this page: click to open one.",
    "note": "This page is one file and needs no connection.",
    "connect": "",
}
LIVE_WORDS = {
    "openable": "▾ marks scans worth a look; click to open any scan.",
    "note": "salsanext view sends the scans while it runs.",
    "connect": "connect-src 'self'",
}
"""Texts of a page that contains its scans, and of a page that asks a server for them."""
OUTCOME_COLOURS = {"not judged": NOT_JUDGED, "right": (125, 133, 145), "wrong": WRONG}
"""Colours of points by outcome, which differ more than those of pictures."""
DARKEST_STEP = 48  # First step, of 255, of the colour map: lower ones are hard to see
DATED = (("predictions",), ("uncertainty",))  # Folders, in those of sequences, that date a page
LONG_FACT = 120  # Longer settings are folded after their first sentence


@dataclass(frozen=True, slots=True)
class Served:
    """Server of a live page."""

    reasons: Mapping[str, str]  # Scans that the server has, and why to look at them
    token: str


def html_of(
    run: RunResults,
    compared: Comparison | None,
    shown: Sequence[ShownScan],
    scales: Mapping[str, Scale],
    failures: Sequence[str],
    thumbnails: Mapping[str, str],
    served: Served | None = None,
) -> str:
    """Return the page of a run; texts from files and names are escaped.

    Parameters
    ----------
    run, compared : RunResults, Comparison or None
        Numbers of all scans, and their comparison with labels.
    shown : sequence of ShownScan
        Scans whose points the page contains.
    scales : mapping of str to Scale
        Scale of every value.
    failures : sequence of str
        Reasons why scans are missing.
    thumbnails : mapping of str to str
        Pictures of some scans, as addresses for `img`, by name.
    served : Served, optional
        Server that a live page asks for points.

    Returns
    -------
    str
    """
    space = run.reader.space
    colours = screen_colours(space)
    class_points = np.array([row.class_points for row in run.rows])
    offered = served.reasons if served else {scan.name: scan.reason for scan in shown}
    data = {
        **_palette(space, colours),
        **_data(run, class_points, offered, thumbnails),
        "scales": scales,
        "live": served is not None,
        "token": served.token if served else "",
    }
    clouds = (encode_cloud(scan, space, run.reader.sensor, scales) for scan in shown)
    blocks = [script_data("data", escaped(data))]
    blocks += [script_data(f"cloud-{i}", escaped(cloud)) for i, cloud in enumerate(clouds)]
    comparison = _comparison(compared, space) if compared else ""
    warnings = [*run.warnings(), *failures]
    return Template(_part("page.html")).substitute(
        title=text_of("/".join(run.reader.out.absolute().parts[-2:])),
        source=text_of(_source(run)),
        version=text_of(__version__),
        overview=overview(run, compared),
        facts="".join(_fact(name, fact) for name, fact in run.facts()),
        warnings=listed("Warnings", '<ul class="warnings">', "</ul>", warnings),
        shares=_shares(class_points.sum(axis=0), compared, space, colours),
        plots=comparison,
        plots_link='<a href="#plots">Comparison with labels</a>' if comparison else "",
        data="".join(blocks),
        **(LIVE_WORDS if served else FILE_WORDS),
        **{name.replace(".", "_"): _part(name) for name in PARTS},
    )


def _data(
    run: RunResults, class_points: Counts, offered: Mapping[str, str], thumbnails: Mapping[str, str]
) -> dict[str, object]:
    """Return numbers of the scans for the scripts; `offered`: scans to open, and why to."""
    names = list(offered)
    return {
        "boxes": bool(find_outputs(run.reader.out, "objects")),
        "uncertain": list(UNCERTAIN),
        "titles": TITLES,
        "shown": [{"name": name, "reason": reason} for name, reason in offered.items()],
        "drive": drive_data(run, class_points, names, thumbnails),
        "cells": cells_of(run.rows, names) if run.counts else {},
        "occurring": _occurring(class_points, run.counts),
    }


def _part(name: str) -> str:
    return resources.files("salsanext_cli.report.page").joinpath(name).read_text("utf-8")


def _source(run: RunResults) -> str:
    """Return the folder of the scans and the day of their results, in words."""
    folders = list(dict.fromkeys(row.file.path.parent for row in run.rows))
    parts = folders[0].parts
    names = "/".join(parts[-4:] if parts[-1] == SCAN_FOLDER else parts[-1:])
    others = f" and {counted(len(folders) - 1, 'more folder')}" if len(folders) > 1 else ""
    written = _day_of_results(run.reader.out)
    return f"scans: {names}{others}{f' · results of {written}' if written else ''}"


def _day_of_results(out: Path) -> str:
    """Return the day when the last result was written, by the list of written files.

    Empty without such a list. A copy of a folder has the list; its files may have other times.
    """
    times_ns = [
        time_ns
        for path, states in OwnedFolder(out).states().items()
        if path.relative_to(out).parts[2:3] in DATED
        for _, time_ns in states
    ]
    if not times_ns:
        return ""
    return datetime.fromtimestamp(max(times_ns) / 1e9, UTC).astimezone().date().isoformat()


def _fact(name: str, fact: str) -> str:
    """Return a setting; a long one is folded after its first sentence."""
    first, dot, rest = fact.partition(". ")
    if not dot or len(fact) <= LONG_FACT:
        return f"<dt>{text_of(name)}</dt><dd>{text_of(fact)}</dd>"
    folded = f"<details><summary>{text_of(first)}.</summary>{text_of(rest)}</details>"
    return f"<dt>{text_of(name)}</dt><dd>{folded}</dd>"


def _palette(space: LabelSpace, colours: Colours) -> dict[str, object]:
    """Return the colours of classes, outcomes and values, as plain data."""
    steps = np.linspace(DARKEST_STEP, 255, NO_VALUE)  # Of the colours of the values 0 to 254
    classes = zip(space.names, colours.tolist(), strict=True)
    return {
        "classes": [{"name": name, "rgb": rgb} for name, rgb in classes],
        "outcomes": [{"name": name, "rgb": rgb} for name, rgb in OUTCOME_COLOURS.items()],
        "map": map_colours(COLOUR_MAP)[steps.astype(np.intp)].ravel().tolist(),
    }


def _shares(
    points: Counts, compared: Comparison | None, space: LabelSpace, colours: Colours
) -> str:
    """Return a table of all predicted or true classes, the largest first."""
    total = int(points.sum())
    if not total:
        return "<p>No stage has predicted labels.</p>"
    ious = {c.train_id: c.iou for c in compared.scores.classes if c.points} if compared else {}
    shares = points / total
    heading = f"<th>class</th><th>share of all {counted(total, 'point')}</th>"
    if ious and compared:
        judged = "accepted" if compared.accepted else "labelled"
        heading += f"<th>IoU of {counted(compared.scores.points, f'{judged} point')}</th>"
    rows = []
    for i in np.argsort(-shares, kind="stable").tolist():
        if not points[i] and i not in ious:
            continue
        rgb = ",".join(map(str, colours[i].tolist()))
        digits = 2 if shares[i] < 0.1 else 1
        share = bar(shares[i] / shares.max(), rgb) + percent(shares[i], digits, " %")
        cells = f"<td>{text_of(space.names[i])}</td><td>{share}</td>"
        if ious:
            width = bar(ious[i], rgb) if i in ious else ""
            cells += f"<td>{width}{percent(ious.get(i, math.nan), 1, ' %')}</td>"
        rows.append(f"<tr>{cells}</tr>")
    return f'<table class="shares"><tr>{heading}</tr>{"".join(rows)}</table>'


def _comparison(compared: Comparison, space: LabelSpace) -> str:
    """Return the section on labelled scans: confusions and plots."""
    parts = confusion_table(compared.counts.confusion, space)
    parts += confusion_list(compared.counts.confusion, space)
    figures = "".join(
        f'<figure tabindex="0"><img alt="{text_of(PICTURES[name])}" '
        f'src="data:image/png;base64,{b64encode(png).decode("ascii")}"></figure>'
        for name, png in uncertainty_pictures(compared.uncertainty).items()
    )
    parts += f'<div class="plots">{figures}</div>' * bool(figures)
    return f'<section id="plots"><h2>Comparison with labels</h2>{parts}</section>' * bool(parts)


def _occurring(class_points: Counts, counts: ScanCounts | None) -> dict[str, list[int]]:
    """Return the classes in any scan, by colour: all scans have the same legend."""
    true = counts.confusion.sum(axis=1) if counts else ()
    points = {"label": class_points.sum(axis=0), "truth": true, "wrong": np.ones(3)}
    return {name: np.flatnonzero(counts).tolist() for name, counts in points.items()}
