# SPDX-License-Identifier: MIT
"""Page of a run as one HTML file: text, pictures and data between the parts of a template."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import resources
from string import Template
from typing import Any

from salsanext_cli import __version__
from salsanext_cli.errors import printable
from salsanext_cli.report.evaluation_pictures import PICTURES

PARTS = ("page.css", "view.js", "drive.js", "page.js")
"""Files beside this one that the template takes in, as $page_css and so on."""


@dataclass(frozen=True, slots=True)
class PageContent:
    """Content of a page.

    Attributes
    ----------
    title : str
        Name of the output folder.
    tiles : sequence of (str, str)
        Numbers for the first screen, each with its name.
    facts, warnings : sequences
        What was run, by title; and doubts about the scans.
    sentence : str
        Sentence on risk; empty without labels.
    shares : sequence of (name, (red, green, blue), share, IoU)
        Share of every predicted class, 0…1, and its IoU as text, empty without labels.
    rings : sequence of tuple of str
        Distance, mean IoU, accuracy and points as text; empty if not asked for.
    pictures : mapping of str to bytes
        PNG by a name of `PICTURES`.
    data : mapping
        What the scripts show: classes, scales, the drive; see `page.js`.
    clouds : sequence of mapping
        As `encode_cloud` returns them.
    """

    title: str
    tiles: Sequence[tuple[str, str]]
    facts: Sequence[tuple[str, str]]
    warnings: Sequence[str]
    sentence: str
    shares: Sequence[tuple[str, tuple[int, int, int], float, str]]
    rings: Sequence[tuple[str, ...]]
    pictures: Mapping[str, bytes]
    data: Mapping[str, Any]
    clouds: Sequence[Mapping[str, Any]] = field(default_factory=list)


def html_of(content: PageContent) -> str:
    """Return the page; every text that comes from files or names is escaped."""
    blocks = [script_data(f"cloud-{i}", each) for i, each in enumerate(content.clouds)]
    template = Template(_part("page.html"))
    return template.substitute(
        title=_text(content.title),
        version=_text(__version__),
        tiles="".join(f"<div><b>{_text(v)}</b>{_text(n)}</div>" for n, v in content.tiles),
        sentence=f'<p class="sentence">{_text(content.sentence)}</p>' if content.sentence else "",
        facts="".join(f"<dt>{_text(n)}</dt><dd>{_text(v)}</dd>" for n, v in content.facts),
        warnings=_warnings(content.warnings),
        shares=_shares(content.shares),
        rings=_rings(content.rings),
        pictures=_pictures(content.pictures),
        data=script_data("data", content.data) + "".join(blocks),
        **{name.replace(".", "_"): _part(name) for name in PARTS},
    )


def script_data(identifier: str, data: Mapping[str, Any]) -> str:
    """Return plain data as an element that scripts read; nothing in it can end the element."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    for mark in "<>&":
        text = text.replace(mark, f"\\u{ord(mark):04x}")
    return f'<script type="application/json" id="{identifier}">{text}</script>\n'


def _part(name: str) -> str:
    return resources.files("salsanext_cli.report.page").joinpath(name).read_text("utf-8")


def _text(text: object) -> str:
    return escape(printable(str(text)))


def _warnings(lines: Sequence[str]) -> str:
    if not lines:
        return ""
    items = "".join(f"<li>{_text(line)}</li>" for line in lines)
    return f'<h3>Warnings</h3><ul class="warnings">{items}</ul>'


def _shares(shares: Sequence[tuple[str, tuple[int, int, int], float, str]]) -> str:
    """Return a table of the classes, the largest first, with bars."""
    if not shares:
        return "<p>No stage has predicted labels.</p>"
    judged = any(iou for *_, iou in shares)
    largest = max(share for *_, share, _ in shares) or 1
    heading = "<th>class</th><th>share of the points</th>" + "<th>IoU</th>" * judged
    rows = []
    for name, (red, green, blue), share, iou in sorted(shares, key=lambda each: -each[2]):
        bar = f'<i style="width:{75 * share / largest:.1f}%;background:rgb({red},{green},{blue})">'
        cells = f"<td>{_text(name)}</td><td>{bar}</i> {_percent(share)}</td>"
        rows.append(f"<tr>{cells}{f'<td>{_text(iou)}</td>' * judged}</tr>")
    return f'<table class="shares"><tr>{heading}</tr>{"".join(rows)}</table>'


def _percent(share: float) -> str:
    return f"{100 * share:.2f} %" if share < 0.1 else f"{100 * share:.1f} %"


def _rings(rows: Iterable[Sequence[str]]) -> str:
    cells = [f"<tr>{''.join(f'<td>{_text(cell)}</td>' for cell in row)}</tr>" for row in rows]
    if not cells:
        return ""
    names = ("distance", "mean IoU %", "accuracy %", "points")
    heading = "".join(f"<th>{name}</th>" for name in names)
    return f"<h3>By distance</h3><table><tr>{heading}</tr>{''.join(cells)}</table>"


def _pictures(pictures: Mapping[str, bytes]) -> str:
    """Return the plots in their order, each with its words for those who cannot see it."""
    return "".join(
        f'<figure tabindex="0"><img alt="{_text(PICTURES[name])}" '
        f'src="data:image/png;base64,{b64encode(png).decode("ascii")}"></figure>'
        for name, png in pictures.items()
    )
