# SPDX-License-Identifier: MIT
"""Recorded settings of a run in words."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.fitting.sensor_texts import view_text
from salsanext_cli.core.measures.risk_control import guarantee_text
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import shortened
from salsanext_cli.core.wording import command, setting
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.weights.card_file import default_weights, named_weights, read_card
from salsanext_cli.runs.records.stage_settings import (
    ComputedSettings,
    FuseSettings,
    PredictSettings,
    StageSettings,
    WeightsSettings,
)
from salsanext_cli.runs.results.folder_names import ERROR
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.provenance import Provenance

SHOWN_DIGITS = 12  # Hexadecimal digits of a SHA-256 on the page


def recorded_facts(out: Path, sensor: Sensor) -> Iterator[tuple[str, str]]:
    """Yield titles and texts of the recorded settings of a run for a sensor."""
    records = Manifest(out)
    yield "Weights", _weights(Provenance(out))
    for member in sensor.members:
        yield "Sensor", f"{member.name}, {member.height}×{member.width}, {view_text(member)}"
    stage = records.owner("predictions")
    labels = records.settings_of("predictions")
    if stage and labels:
        yield "Labels", _labels(stage, labels)
        if isinstance(labels, PredictSettings) and labels.guarantee:
            yield "Guarantee", guarantee_text(labels.guarantee)
        if isinstance(labels, WeightsSettings) and labels.inherited:
            parts = shortened(labels.inherited, 200)
            yield "Inherited", f"{parts}, not fitted to these weights"
    settings = records.settings("uncertainty")
    if settings:
        numbers = {name: getattr(settings, name) for name in ("samples", "seed", "aleatoric")}
        texts = (f"{name} {value}" for name, value in numbers.items() if value is not None)
        yield "Uncertainty", ", ".join([str(settings.method), *texts])
    if records.owner(ERROR) == "predict":
        made = command("predict", setting("extras", (ERROR,)))
        yield "Uncertainty", f"probability of error, from {made}"


def _weights(provenance: Provenance) -> str:
    """Describe the weights behind the labels, else those behind the uncertainty."""
    folders = ("predictions", "uncertainty/epistemic", "uncertainty/error", "pixel_labels")
    sha256 = next(filter(None, map(provenance.weights, folders)), None)
    if sha256 is None:
        return "not recorded"
    name = f"SHA-256 {sha256[:SHOWN_DIGITS]}"
    path = default_weights()
    # An installation without its weights still shows results.
    with suppress(SalsanextError):
        if fingerprint(path) == sha256:
            card = read_card(path)
            text = re.sub(r"See \S+\.md; (.)", lambda rest: rest[1].upper(), card.description)
            name = named_weights(card, path) if card.version else f"default weights, {name}"
            return f"{name}. {text.replace('`', '')}"
    return f"{name}, not the default weights; salsanext models FILE describes them"


def _labels(stage: str, settings: StageSettings) -> str:
    words = [stage]
    if isinstance(settings, ComputedSettings) and settings.engine:
        words.append(f"{settings.engine} in {settings.precision}")
    if isinstance(settings, PredictSettings | FuseSettings) and settings.temperature is not None:
        words.append(f"temperature {settings.temperature:.3g}")
    if isinstance(settings, PredictSettings) and settings.reject is not None:
        kind = (settings.reject_by or "error").replace("_", " ")
        words.append(f"points rejected: {kind} above {settings.reject:g}")
    return ", ".join(words)
