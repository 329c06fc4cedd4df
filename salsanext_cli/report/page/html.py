# SPDX-License-Identifier: MIT
"""Page of a run as one HTML file: a template filled with text, pictures and data."""

from __future__ import annotations

import json
import math
from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources
from string import Template

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import counted, escaped, printable
from salsanext_cli.measures.scan_counts import ScanCounts
from salsanext_cli.measures.scores import Counts, largest_confusions, scored_rows
from salsanext_cli.report.colours import (
    COLOUR_MAP,
    NOT_JUDGED,
    WRONG,
    Colours,
    map_colours,
    screen_colours,
)
from salsanext_cli.report.page.clouds import NO_VALUE, Scale, base64_of, encode_cloud
from salsanext_cli.report.page.run_results import UNCERTAIN, Comparison, RunResults, ShownScan
from salsanext_cli.report.plots import PICTURES, uncertainty_pictures
from salsanext_cli.report.tables import percent
from salsanext_cli.results.paths import find_outputs
from salsanext_cli.version import __version__

PARTS = ("page.css", "view.js", "drive.js", "scans.js", "page.js")
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
MAX_CONFUSIONS = 10


def html_of(
    run: RunResults,
    compared: Comparison | None,
    shown: Sequence[ShownScan],
    scales: Mapping[str, Scale],
    failures: Sequence[str] = (),
    *,
    served: Mapping[str, str] | None = None,
    token: str = "",
) -> str:
    """Return the page of a run; texts from files and names are escaped.

    `shown`: scans whose points the page contains; `failures`: reasons why scans are missing;
    `served`: scans whose points the page asks a server for, and why to look at them; `token`: of
    this server.
    """
    out, space, sensor = run.reader.out, run.reader.space, run.reader.sensor
    live = served is not None
    offered = {scan.name: scan.reason for scan in shown} if served is None else served
    colours, class_points = screen_colours(space), np.array([r.class_points for r in run.rows])
    steps = np.linspace(DARKEST_STEP, 255, NO_VALUE)  # Of the colours of the values 0 to 254
    named_colours = zip(space.names, colours.tolist(), strict=True)
    data = {
        "classes": [{"name": name, "rgb": rgb} for name, rgb in named_colours],
        "outcomes": [{"name": name, "rgb": rgb} for name, rgb in OUTCOME_COLOURS.items()],
        "scales": scales,
        "boxes": bool(find_outputs(out, "objects")),
        "uncertain": list(UNCERTAIN),
        "map": map_colours(COLOUR_MAP)[steps.astype(np.intp)].ravel().tolist(),
        "shown": [{"name": name, "reason": reason} for name, reason in offered.items()],
        "drive": _drive(run, class_points, list(offered)),
        "occurring": _occurring(class_points, run.counts),
    }
    blocks = [script_data("data", {**escaped(data), "live": live, "token": token})]
    for i, scan in enumerate(shown):
        blocks.append(script_data(f"cloud-{i}", escaped(encode_cloud(scan, space, sensor, scales))))
    comparison = _comparison(compared, space) if compared else ""
    facts, warnings = run.facts(), [*run.warnings(), *failures]
    return Template(_part("page.html")).substitute(
        title=_text("/".join(out.absolute().parts[-2:])),
        version=_text(__version__),
        tiles=_tiles(run, compared),
        sentence=_sentence(compared),
        facts="".join(f"<dt>{_text(name)}</dt><dd>{_text(fact)}</dd>" for name, fact in facts),
        warnings=_listed("Warnings", '<ul class="warnings">', "</ul>", warnings),
        shares=_shares(class_points.sum(axis=0), compared, space, colours),
        plots=comparison,
        plots_link='<a href="#plots">Comparison</a>' if comparison else "",
        data="".join(blocks),
        **(LIVE_WORDS if live else FILE_WORDS),
        **{name.replace(".", "_"): _part(name) for name in PARTS},
    )


def script_data(identifier: str, data: object) -> str:
    """Return plain data as an element for scripts; no text in it can end the element."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    for mark in "<>&":
        text = text.replace(mark, f"\\u{ord(mark):04x}")
    return f'<script type="application/json" id="{identifier}">{text}</script>\n'


def _part(name: str) -> str:
    return resources.files("salsanext_cli.report.page").joinpath(name).read_text("utf-8")


def _text(text: object) -> str:
    return escape(printable(str(text)))


def _listed(heading: str, start: str, end: str, lines: Sequence[str]) -> str:
    if not lines:
        return ""
    items = "".join(f"<li>{_text(line)}</li>" for line in lines)
    return f"<h3>{heading}</h3>{start}{items}{end}"


def _tiles(run: RunResults, compared: Comparison | None) -> str:
    points = sum(row.points for row in run.rows)
    tiles = [("scans", f"{len(run.rows):,}"), ("points", f"{points:,}")]
    if compared:
        result, scans = compared.scores, counted(compared.counts.scans, "scan")
        which = "trained on" if compared.counts.trained_on else "with labels"
        if labels := compared.accepted:
            coverage = percent(labels.coverage, 1, " %")
            tiles.append((f"coverage: accepted points of {scans} {which}", coverage))
            tiles.append(("risk: wrong points among them", percent(labels.risk, 1, " %")))
        else:
            present = sum(c.points > 0 for c in result.classes)
            iou = percent(result.iou_mean_present, 1, " %")
            tiles.append((f"accuracy, {scans} {which}", percent(result.accuracy, 1, " %")))
            tiles.append((f"mean IoU of {present} classes present", iou))
            if present < len(result.classes):
                official = percent(result.iou_mean_official, 1, " %")
                tiles.append((f"mean IoU of all {len(result.classes)}, official", official))
    return "".join(f"<div><b>{_text(value)}</b>{_text(name)}</div>" for name, value in tiles)


def _sentence(compared: Comparison | None) -> str:
    """Return the sentences on risk; empty without labels and uncertainty."""
    if compared is None:
        return ""
    best = compared.uncertainty.accepted
    sentences = [*compared.sentences, *([best.sentence] if best else [])]
    return "".join(f'<p class="sentence">{_text(s[:1].upper() + s[1:])}.</p>' for s in sentences)


def _shares(
    points: Counts, compared: Comparison | None, space: LabelSpace, colours: Colours
) -> str:
    """Return a table of all predicted or true classes, the largest first."""
    if not points.any():
        return "<p>No stage has predicted labels.</p>"
    ious = {c.train_id: c.iou for c in compared.scores.classes if c.points} if compared else {}
    shares = points / points.sum()
    heading = "<th>class</th><th>share of the points</th>"
    if ious and compared:
        heading += f"<th>IoU{' of accepted points' * bool(compared.accepted)}</th>"
    rows = []
    for i in np.argsort(-shares, kind="stable").tolist():
        if not points[i] and i not in ious:
            continue
        rgb = ",".join(map(str, colours[i].tolist()))
        digits = 2 if shares[i] < 0.1 else 1
        share = _bar(shares[i] / shares.max(), rgb) + percent(shares[i], digits, " %")
        cells = f"<td>{_text(space.names[i])}</td><td>{share}</td>"
        if ious:
            bar = _bar(ious[i], rgb) if i in ious else ""
            cells += f"<td>{bar}{percent(ious.get(i, math.nan), 1, ' %')}</td>"
        rows.append(f"<tr>{cells}</tr>")
    return f'<table class="shares"><tr>{heading}</tr>{"".join(rows)}</table>'


def _bar(share: float, rgb: str) -> str:
    return f'<i style="width:{65 * share:.1f}%;background:rgb({rgb})"></i> '


def _comparison(compared: Comparison, space: LabelSpace) -> str:
    """Return the section on labelled scans: confusions and plots."""
    confusions = _confusions(compared.counts.confusion, space)
    parts = _listed("Largest confusions", '<ol class="confusions">', "</ol>", confusions)
    figures = "".join(
        f'<figure tabindex="0"><img alt="{_text(PICTURES[name])}" '
        f'src="data:image/png;base64,{b64encode(png).decode("ascii")}"></figure>'
        for name, png in uncertainty_pictures(compared.uncertainty).items()
    )
    parts += f'<div class="plots">{figures}</div>' * bool(figures)
    return f'<section id="plots"><h2>Comparison with labels</h2>{parts}</section>' * bool(parts)


def _confusions(confusion: Counts, space: LabelSpace) -> list[str]:
    """Return the most frequent confusions in words."""
    matrix, names = scored_rows(confusion, space), space.names
    truths = matrix.sum(axis=1).tolist()
    return [
        f"{names[true]} taken for {names[predicted]}: "
        f"{percent(points / truths[true], 1, ' %')} of {counted(truths[true], 'point')}"
        for true, predicted, points in largest_confusions(matrix, MAX_CONFUSIONS)
    ]


def _occurring(class_points: Counts, counts: ScanCounts | None) -> dict[str, list[int]]:
    """Return the classes in any scan, by colour: all scans have the same legend."""
    true = counts.confusion.sum(axis=1) if counts else ()
    points = {"label": class_points.sum(axis=0), "truth": true, "wrong": np.ones(3)}
    return {name: np.flatnonzero(counts).tolist() for name, counts in points.items()}


def _drive(run: RunResults, class_points: Counts, shown: Sequence[str]) -> dict[str, object]:
    """Return the numbers of all scans as base64 of float32, empty where unknown."""
    places = {name: place for place, name in enumerate(shown)}
    kind = run.leading_kind or ""
    means = np.array([row.uncertainty.get(kind, np.nan) for row in run.rows])
    wrong = np.array([row.wrong for row in run.rows])
    shares = class_points / np.maximum(class_points.sum(axis=1, keepdims=True), 1)
    return {
        "names": [row.file.name for row in run.rows],
        "shown": [places.get(row.file.name, -1) for row in run.rows],
        "kind": kind.replace("_", " "),
        "uncertainty": "" if np.isnan(means).all() else base64_of(means, "<f4"),
        "wrong": "" if np.isnan(wrong).all() else base64_of(wrong, "<f4"),
        "shares": base64_of(shares, "<f4") if class_points.any() else "",
    }
