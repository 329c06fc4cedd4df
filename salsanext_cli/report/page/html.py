# SPDX-License-Identifier: MIT
"""Page of a run as one HTML file: a template filled with text, pictures and data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from salsanext_cli.core.texts import escaped
from salsanext_cli.report.colours import screen_colours
from salsanext_cli.report.mapped_drives import drive_maps
from salsanext_cli.report.page.class_table import class_table
from salsanext_cli.report.page.clouds import Scale, encode_cloud
from salsanext_cli.report.page.labelled_scans import labelled_scans
from salsanext_cli.report.page.other_run import other_run
from salsanext_cli.report.page.overview import overview
from salsanext_cli.report.page.rendering import render
from salsanext_cli.report.page.run_results import Comparison, RunResults, ShownScan
from salsanext_cli.report.page.run_source import run_source
from salsanext_cli.report.page.script_data import script_data
from salsanext_cli.version import __version__

LONG_FACT = 120  # Longer settings are folded after their first sentence


@dataclass(frozen=True, slots=True, kw_only=True)
class Fact:
    """A setting of a run."""

    name: str
    summary: str
    rest: str  # Further sentences, which are folded; empty without any


@dataclass(frozen=True, slots=True, kw_only=True)
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
    run : RunResults
        Numbers of all scans.
    compared : Comparison or None
        Their comparison with labels.
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
        **script_data(run, class_points, colours, offered, thumbnails),
        "scales": scales,
        "live": served is not None,
        "token": served.token if served else "",
    }
    clouds = [encode_cloud(scan, space, run.reader.sensor, scales) for scan in shown]
    return render(
        {
            "title": "/".join(run.reader.out.absolute().parts[-2:]),
            "source": run_source(run),
            "version": __version__,
            "served": served is not None,
            "overview": overview(run, compared),
            "facts": [_folded(name, text) for name, text in run.facts()],
            "warnings": [*run.warnings(), *failures],
            "classes": class_table(class_points.sum(axis=0), compared, space, colours),
            "comparison": labelled_scans(compared, space) if compared else None,
            "drive_maps": drive_maps(run),
            "other_run": other_run(run.reader.out),
            "data": escaped(data),
            "clouds": escaped(clouds),
        }
    )


def _folded(name: str, text: str) -> Fact:
    """Return a setting; a long one is folded after its first sentence."""
    first, stop, rest = text.partition(". ")
    if not stop or len(text) <= LONG_FACT:
        return Fact(name=name, summary=text, rest="")
    return Fact(name=name, summary=f"{first}.", rest=rest)
