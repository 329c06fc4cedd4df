# SPDX-License-Identifier: MIT
"""Facts about a run for the first screen of its page, as its stages recorded them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from statistics import mean
from typing import Any

from salsanext_cli.errors import SalsanextError, counted, first_few
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.fitting.view_fit import view_text
from salsanext_cli.network.card import default_weights, read_card
from salsanext_cli.results.layout import ERROR, find_outputs
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.stage_records import StageRecords
from salsanext_cli.sensors.sensor import Sensor

DEFAULT_LIMITS = (
    "On real scans they find fences where there are none, take trucks for fence, sidewalk, "
    "building or car, hardly tell parking from road and sidewalk, and hardly ever find cyclists."
)
"""Failures of the default weights, as docs/model-card.md has them; it does not come with a page."""
SHOWN_DIGITS = 12
"""Hexadecimal digits of a SHA-256 that are shown."""
LEAST_TIMED = 4
"""Scans that it takes to say how long one takes."""
PAUSE_S = 60.0
"""Time between two results from which on nothing ran in between."""
CHECKED_STAGES = ("project", "predict", "uncertainty")
"""Stages that check scans."""


def facts_of_run(out: Path, sensor: Sensor) -> Iterator[tuple[str, str]]:
    """Yield what was run and how, as pairs of a title and a text."""
    records = StageRecords(out)
    yield "Weights", _weights(records)
    yield "Sensor", f"{sensor.name}, {sensor.height}×{sensor.width}, {view_text(sensor)}"
    if stage := records.owner("predictions"):
        yield "Labels", _labels(stage, records.settings(stage) or {})
    if settings := records.settings("uncertainty"):
        numbers = ("samples", "seed", "aleatoric")
        given = (f"{key} {settings[key]}" for key in numbers if key in settings)
        yield "Uncertainty", ", ".join([str(settings.get("method")), *given])
    if records.owner(ERROR) == "predict":
        yield "Uncertainty", "probability of error, of predict --error"
    folders = ("predictions", "uncertainty/epistemic")
    for stage, folder in {records.owner(folder): folder for folder in folders}.items():
        if stage and (seconds := _seconds_per_scan(out, folder)):
            yield "Time", f"{stage}: {seconds:.2g} s per scan"


def _weights(records: StageRecords) -> str:
    """Describe the weights behind the labels, else those behind the uncertainty."""
    folders = ("predictions", "uncertainty/epistemic", "uncertainty/error", "pixel_labels")
    sha256 = next(filter(None, map(records.weights, folders)), None)
    if sha256 is None:
        return "not recorded"
    name = f"SHA-256 {sha256[:SHOWN_DIGITS]}"
    path = default_weights()
    # An installation without its weights still has results to show.
    with suppress(SalsanextError):
        if fingerprint(path) == sha256:
            description = read_card(path).description.replace("`", "")
            own = re.sub(r"See docs/\S+ (.)", lambda rest: rest[1].upper(), description)
            return f"the default ones, {name}. {own} {DEFAULT_LIMITS}"
    return f"{name}, not the default ones; salsanext models FILE describes a file of weights"


def _labels(stage: str, settings: Mapping[str, Any]) -> str:
    words = [stage]
    if settings.get("engine"):
        words.append(f"{settings['engine']} in {settings.get('precision')}")
    if isinstance(temperature := settings.get("temperature"), float):
        words.append(f"temperature {temperature:.3g}")
    if settings.get("adapted"):
        words.append("batch norm adapted to the scans")
    if settings.get("reject") is not None:
        words.append(f"points unlabelled whose error is above {settings['reject']:g}")
    return ", ".join(words)


def _seconds_per_scan(out: Path, folder: str) -> float | None:
    """Return the mean time between two results, pauses left out.

    None of a folder whose files are not those that were written there, such as a copy.
    """
    paths = list(find_outputs(out, folder).values())
    if len(paths) < LEAST_TIMED or OwnedFolder(out).others(paths):
        return None
    written = sorted(path.stat().st_mtime_ns for path in paths)
    gaps_s = [gap / 1e9 for a, b in pairwise(written) if (gap := b - a) < PAUSE_S * 1e9]
    return mean(gaps_s) if gaps_s else None


def warnings_of_run(out: Path, wanted: Collection[str]) -> list[str]:
    """Return what the stages found doubtful about the wanted scans, a line for each kind."""
    scans: dict[str, list[str]] = {}
    words: dict[str, Counter[str]] = {}
    for stage in CHECKED_STAGES:
        for name, findings in OwnedFolder(out, stage).findings().items():
            if name not in wanted:
                continue
            for code, message, remedy in findings:
                if name not in scans.setdefault(code, []):
                    scans[code].append(name)
                words.setdefault(code, Counter())[f"{message}; {remedy}"] += 1
    return [
        f"{code} in {counted(len(names), 'scan')} ({first_few(names)}): "
        f"{words[code].most_common(1)[0][0]}"
        for code, names in sorted(scans.items())
    ]
