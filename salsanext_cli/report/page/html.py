# SPDX-License-Identifier: MIT
"""Page of a run as one HTML file: text, pictures and data between the parts of a template."""

from __future__ import annotations

import json
import math
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import resources
from string import Template
from typing import Any, NamedTuple

from salsanext_cli.errors import printable
from salsanext_cli.report.plots import PICTURES
from salsanext_cli.report.tables import percent
from salsanext_cli.version import __version__

PARTS = ("page.css", "view.js", "drive.js", "scans.js", "page.js")
"""Files beside this one that the template takes in, as $page_css and so on."""

FILE_WORDS = {
    "openable": "▾ marks those of this page: a click opens them.",
    "note": "This page fetches nothing; it can be kept and sent as one file.",
    "connect": "",
}
LIVE_WORDS = {
    "openable": "▾ marks those worth a look; a click opens any.",
    "note": "The scans come from salsanext view while it runs.",
    "connect": "connect-src 'self'",
}
"""Parts of a page that holds its scans, and of one that asks a server for them."""


class ClassShare(NamedTuple):
    """A class, its colour, its share of the points and its IoU, 0…1, NaN if not in the truth."""

    name: str
    colour: Sequence[int]
    share: float
    iou: float


@dataclass(frozen=True, slots=True)
class PageContent:
    """Content of a page."""

    title: str  # Name of the output folder
    tiles: Sequence[tuple[str, str]]  # Numbers for the first screen, each with its name
    facts: Sequence[tuple[str, str]]  # What was run, by title; and warnings about the scans
    warnings: Sequence[str]
    shares: Sequence[ClassShare]  # Classes; empty without predictions
    data: Mapping[str, Any]  # What the scripts show besides: classes, scales, the drive
    clouds: Sequence[Mapping[str, Any]]  # As `encode_cloud` returns them
    sentence: str = ""  # Sentence on risk; empty without labels
    # Distance, mean IoU, accuracy and points as text; empty if not asked for
    rings: Sequence[tuple[str, ...]] = ()
    confusions: Sequence[str] = ()  # What is taken for what, in words
    # PNG by a name of `PICTURES`, all of one size
    pictures: Mapping[str, bytes] = field(default_factory=dict)
    # Whether the page asks a server for its clouds, and so for those of any number of scans
    live: bool = False


def html_of(content: PageContent, token: str = "") -> str:
    """Return the page; every text that comes from files or names is escaped.

    `token` is that of the server of a live page.
    """
    blocks = [script_data(f"cloud-{i}", each) for i, each in enumerate(content.clouds)]
    data = {**content.data, "live": content.live, "token": token}
    template = Template(_part("page.html"))
    return template.substitute(
        title=_text(content.title),
        version=_text(__version__),
        tiles="".join(f"<div><b>{_text(v)}</b>{_text(n)}</div>" for n, v in content.tiles),
        sentence=f'<p class="sentence">{_text(content.sentence)}</p>' if content.sentence else "",
        facts="".join(f"<dt>{_text(n)}</dt><dd>{_text(v)}</dd>" for n, v in content.facts),
        warnings=_warnings(content.warnings),
        shares=_shares(content.shares),
        plots=(plots := _plots(content)),
        plots_link='<a href="#plots">Comparison</a>' if plots else "",
        data=script_data("data", data) + "".join(blocks),
        **(LIVE_WORDS if content.live else FILE_WORDS),
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


def _shares(shares: Sequence[ClassShare]) -> str:
    """Return a table of the classes, the largest first, with bars."""
    if not shares:
        return "<p>No stage has predicted labels.</p>"
    judged = not all(math.isnan(each.iou) for each in shares)
    largest = max(each.share for each in shares)
    heading = "<th>class</th><th>share of the points</th>" + "<th>IoU</th>" * judged
    rows = []
    for name, colour, share, iou in sorted(shares, key=lambda each: -each.share):
        cells = f"<td>{_text(name)}</td><td>{_bar(share / largest, colour)}{_percent(share)}</td>"
        if judged:
            bar = "" if math.isnan(iou) else _bar(iou, colour)
            cells += f"<td>{bar}{percent(iou, 1, ' %')}</td>"
        rows.append(f"<tr>{cells}</tr>")
    return f'<table class="shares"><tr>{heading}</tr>{"".join(rows)}</table>'


def _bar(share: float, colour: Sequence[int]) -> str:
    rgb = ",".join(map(str, colour))
    return f'<i style="width:{65 * share:.1f}%;background:rgb({rgb})"></i> '


def _percent(share: float) -> str:
    return f"{100 * share:.2f} %" if share < 0.1 else f"{100 * share:.1f} %"


def _plots(content: PageContent) -> str:
    """Return the section that only labelled scans have."""
    figures = f'<div class="plots">{_pictures(content.pictures)}</div>' * bool(content.pictures)
    parts = _rings(content.rings) + _confusions(content.confusions) + figures
    return f'<section id="plots"><h2>Comparison with labels</h2>{parts}</section>' * bool(parts)


def _rings(rows: Iterable[Sequence[str]]) -> str:
    cells = [f"<tr>{''.join(f'<td>{_text(cell)}</td>' for cell in row)}</tr>" for row in rows]
    if not cells:
        return ""
    names = ("distance", "mean IoU %", "accuracy %", "points")
    heading = "".join(f"<th>{name}</th>" for name in names)
    return f"<h3>By distance</h3><table><tr>{heading}</tr>{''.join(cells)}</table>"


def _confusions(lines: Sequence[str]) -> str:
    if not lines:
        return ""
    items = "".join(f"<li>{_text(line)}</li>" for line in lines)
    return f'<h3>Largest confusions</h3><ol class="confusions">{items}</ol>'


def _pictures(pictures: Mapping[str, bytes]) -> str:
    """Return the plots in their order, each with its words for those who cannot see it."""
    return "".join(
        f'<figure tabindex="0"><img alt="{_text(PICTURES[name])}" '
        f'src="data:image/png;base64,{b64encode(png).decode("ascii")}"></figure>'
        for name, png in pictures.items()
    )
