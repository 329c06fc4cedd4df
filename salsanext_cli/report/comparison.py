# SPDX-License-Identifier: MIT
"""Tables and a page of what changed between two runs."""

import io
from base64 import b64encode
from collections.abc import Sequence
from html import escape as escape_html

import numpy as np
from rich.console import Console, Group
from rich.table import Table

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import counted, printable
from salsanext_cli.geometry.projection import in_sensor_frame
from salsanext_cli.measures.paired import Difference, RunComparison, ScanPair, changed
from salsanext_cli.report.colours import legend_of, screen_colours
from salsanext_cli.report.scan_pictures import scan_picture
from salsanext_cli.report.tables import ABSENT, percent, table_of
from salsanext_cli.results.result_folder import ScanResults
from salsanext_cli.sensors.sensor import Sensor

CHANGES = {
    "same label": (70, 75, 86),
    "other label": (235, 235, 240),
    "now right": (70, 200, 110),
    "now wrong": (255, 72, 48),
}
PAGE = """<!doctype html><meta charset="utf-8"><title>{title}</title><style>
body{{background:#16181d;color:#e8e8ea;font:15px sans-serif;margin:2em}}img{{max-width:100%}}
</style><h1>{title}</h1>{body}"""
INTERVAL = "* the interval, over scans, leaves out 0; of scans of one drive it is too narrow\n"
ACCEPTED = "coverage: share of the points with a label; risk: share of these that is wrong"
DIFFERENCE = ("before %", "after %", "difference", "95 % interval")


def _signed(share: float) -> str:
    return ABSENT if np.isnan(share) else f"{100 * share:+.1f}"


def _cells(score: Difference) -> tuple[str, ...]:
    clear = "*" * (score.low > 0 or score.high < 0)
    interval = f"{_signed(score.low)} … {_signed(score.high)}{clear:1}"
    interval = ABSENT if np.isnan(score.low) else interval
    return percent(score.before), percent(score.after), _signed(score.difference), interval


def comparison_tables(compared: RunComparison) -> Group:
    """Return tables of the scores if there are any, of turned classes, and of changed scans."""
    tables: list[Table | str] = []
    if compared.scores:
        rows = [(name, *_cells(score)) for name, score in compared.scores.items()]
        title = f"{counted(len(compared.sums), 'scan')} with truth, not trained on"
        caption = INTERVAL + (ACCEPTED if compared.rejecting else "score of a class: its IoU")
        tables.append(table_of(("score", *DIFFERENCE), rows, title=title, caption=caption))
    if compared.bands:
        rows = [(name, *_cells(mean)) for name, (_, mean) in compared.bands.items()]
        title = "Risk" if compared.rejecting else "Mean IoU of the same classes"
        tables.append(table_of(("distance", *DIFFERENCE), rows, title=title))
    if seen := sum(pair.trained_on for pair in compared.pairs):
        which = "all scans" if seen == len(compared.pairs) else counted(seen, "scan")
        tables.append(f"{which} not scored: the weights of a run were trained on them")
    of_scans = f"Labels of {counted(len(compared.pairs), 'scan')}"
    if not (most_changed := compared.most_changed()):
        return Group(*tables, f"{of_scans}: all are the same")
    turns = (
        (before, after, f"{points:,}", percent(share))
        for before, after, points, share in compared.turns()
    )
    title = f"{of_scans}: {percent(1 - changed(compared.turned))} % are the same"
    headings = ("before", "after", "points", "share %")
    tables.append(table_of(headings, turns, texts=["after"], title=title))
    scans = []
    for pair in most_changed:
        numbers = percent(changed(pair.turned)), _signed(compared.difference(pair))
        scans.append((pair.file.name, *numbers, "trained on" * pair.trained_on))
    headings = ("scan", "changed %", "risk" if compared.rejecting else "accuracy", "note")
    return Group(*tables, table_of(headings, scans, title="Scans that changed most"))


def change_picture(
    pair: ScanPair, before: ScanResults, after: ScanResults, space: LabelSpace, sensor: Sensor
) -> bytes:
    """Draw a scan from above with the labels of both runs, the truth if known, and the changes."""
    named = {"before": before.label, "after": after.label, "truth": before.truth}
    train = {
        name: space.to_train(raw, strict=False) for name, raw in named.items() if raw is not None
    }
    kind = (train["before"] != train["after"]).astype(np.intp)
    if "truth" in train:
        judged = space.scored[train["truth"]] & (kind > 0)
        judged &= True if after.rejected is None else ~after.rejected
        kind[judged & (train["after"] == train["truth"])] = 2
        kind[judged & (train["before"] == train["truth"])] = 3
    views = {name: screen_colours(space)[ids] for name, ids in train.items()}
    views["changes"] = np.array(list(CHANGES.values()), np.uint8)[kind]
    heading = f"{pair.file.name}   {percent(changed(pair.turned))} % changed"
    heading += "   trained on" * pair.trained_on
    legend = [*legend_of(space, *train.values()), *CHANGES.items()]
    points = in_sensor_frame(before.scan, before.sensor or sensor).points
    return scan_picture(printable(heading), points, views, legend=legend)


def comparison_page(compared: RunComparison, title: str, pictures: Sequence[bytes]) -> bytes:
    """Return the tables, and pictures of scans, as one HTML file."""
    console = Console(record=True, file=io.StringIO(), width=110)
    console.print(comparison_tables(compared))
    tables = console.export_html(inline_styles=True, code_format="<pre>{code}</pre>")
    images = (f'<p><img src="data:image/png;base64,{b64encode(p).decode()}">' for p in pictures)
    title = escape_html(printable(title))
    return PAGE.format(title=title, body=tables + "".join(images)).encode()
