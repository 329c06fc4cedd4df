# SPDX-License-Identifier: MIT
"""Tables and a page of what changed between two runs."""

import io
from base64 import b64encode
from collections.abc import Sequence
from html import escape as escape_html

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.markup import escape

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import counted, printable
from salsanext_cli.geometry.projection import in_sensor_frame
from salsanext_cli.measures.paired import Difference, RunComparison, ScanPair, changed
from salsanext_cli.report.colours import legend_of, screen_colours
from salsanext_cli.report.scan_pictures import scan_picture
from salsanext_cli.report.tables import ABSENT, number_table, percent
from salsanext_cli.results.result_folder import ScanResults
from salsanext_cli.sensors.sensor import Sensor

CHANGES = {
    "same label": (70, 75, 86),
    "other label": (250, 205, 60),
    "now right": (70, 200, 110),
    "now wrong": (255, 72, 48),
}
PAGE = """<!doctype html><meta charset="utf-8"><title>{title}</title><style>
body{{background:#16181d;color:#e8e8ea;font:15px sans-serif;margin:2em}}img{{max-width:100%}}
</style><h1>{title}</h1>{body}"""
DIFFERENCE = ("before %", "after %", "difference", "95 % interval")


def _cells(found: Difference) -> tuple[str, ...]:
    points = [ABSENT if np.isnan(x) else f"{100 * x:+.1f}" for x in found[2:]]
    clear = "*" * (found.low > 0 or found.high < 0)
    interval = ABSENT if np.isnan(found.low) else f"{points[1]} … {points[2]}{clear:1}"
    return percent(found.before), percent(found.after), points[0], interval


def comparison_tables(found: RunComparison) -> Group:
    """Return tables of the scores if there are any, of turned classes, and of changed scans."""
    shown: list[RenderableType] = []
    if found.scores:
        scans = f"{counted(len(found.sums), 'scan')} with truth, not trained on"
        table = number_table("score", *DIFFERENCE, title=scans, no_wrap=True)
        table.caption = "* the interval, over scans, leaves out 0; score of a class: its IoU"
        for name, each in found.scores.items():
            table.add_row(escape(name), *_cells(each))
        shown.append(table)
    if found.rings:
        table = number_table("distance", *DIFFERENCE, title="Mean IoU of the same classes")
        for name, (_, mean) in found.rings.items():
            table.add_row(name, *_cells(mean))
        shown.append(table)
    share = percent(1 - changed(found.turned))
    title = f"Labels of {counted(len(found.pairs), 'scan')}: {share} % are the same"
    table = number_table("before", "after", "points", "share %", title=title)
    for before, after, points, part in found.turns():
        table.add_row(escape(before), escape(after), f"{points:,}", percent(part))
    shown.append(table)
    table = number_table("scan", "changed %", "accuracy", title="Scans that changed most")
    table.add_column("")
    for pair in found.most_changed():
        gain = ABSENT if np.isnan(pair.gain) else f"{100 * pair.gain:+.1f}"
        mark = "trained on" * pair.trained_on
        table.add_row(escape(printable(pair.file.name)), percent(changed(pair.turned)), gain, mark)
    return Group(*shown, table)


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
        kind[judged & (train["after"] == train["truth"])] = 2
        kind[judged & (train["before"] == train["truth"])] = 3
    views = {name: screen_colours(space)[ids] for name, ids in train.items()}
    views["changes"] = np.array(list(CHANGES.values()), np.uint8)[kind]
    heading = f"{pair.file.name}   {percent(changed(pair.turned))} % changed"
    heading += "   trained on" * pair.trained_on
    legend = [*legend_of(space, *train.values()), *CHANGES.items()]
    points = in_sensor_frame(before.scan, sensor).points
    return scan_picture(printable(heading), points, views, legend=legend)


def comparison_page(found: RunComparison, title: str, pictures: Sequence[bytes]) -> bytes:
    """Return the tables, and pictures of scans, as one HTML file."""
    console = Console(record=True, file=io.StringIO(), width=110)
    console.print(comparison_tables(found))
    tables = console.export_html(inline_styles=True, code_format="<pre>{code}</pre>")
    images = (f'<p><img src="data:image/png;base64,{b64encode(p).decode()}">' for p in pictures)
    title = escape_html(printable(title))
    return PAGE.format(title=title, body=tables + "".join(images)).encode()
