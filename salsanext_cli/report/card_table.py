# SPDX-License-Identifier: MIT
"""Table for a terminal: what the card of a weights file contains, in words."""

from collections.abc import Mapping
from typing import Any

from rich.table import Table

from salsanext_cli.core.measures.risk_control import guarantee_text
from salsanext_cli.core.network.card import INHERITED
from salsanext_cli.core.texts import counted, first_few
from salsanext_cli.io.weights.card_file import DescribedWeights
from salsanext_cli.report.tables import ABSENT, percent, table_of

Json = Mapping[str, Any]

SCORE_NAMES = {
    "miou": "mean IoU",
    "miou_spread": "spread of the mean IoU",
    "accuracy_spread": "spread of the accuracy",
    "class_count": "classes",
    "auroc": "AUROC",
    "aurc": "AURC",
    "ece": "ECE",
    "nll": "NLL",
    "risk_80": "wrong of the best 80 %",
}
"""Names of keys in cards; other keys are words already."""
IOU = "iou_"  # Prefix of the key of a class


def card_table(file: DescribedWeights) -> Table:
    """Return a table of the card of a weights file."""
    card = file.card
    sensor = file.card.sensor
    view = f"{sensor.fov_up:+g}° to {sensor.fov_down:+g}°"
    rows = {
        "weights": f"default weights version {card.version}" if card.version else "",
        "description": card.description or ABSENT,
        "architecture": _architecture(card.architecture),
        "temperature": f"{card.temperature:.4g}",
        "label space": f"{card.space.name}, {card.space.class_count} classes",
        "sensor": f"{sensor.name}, {sensor.height}×{sensor.width}, {view}",
        "widths": ", ".join(map(str, card.trained_widths)),
        "scores on the scans that chose the weights": _named(card.scores) or ABSENT,
        **(_error_rows(card.error.scores) if card.error else {}),
        "risk threshold": card.risk and guarantee_text(card.risk),
        "training scans": card.trained_on and f"{len(card.trained_on):,}",
        "size": f"{file.size / 1e6:.1f} MB",
        "SHA-256": file.sha256,
        "SHA-256 of the tensors": card.tensors_sha256 and f"{card.tensors_sha256}, intact",
    }
    stated = [(name, str(text)) for name, text in rows.items() if text]
    table = table_of(("", "value"), stated, texts=["value"], title=str(file.path))
    table.show_header = False
    return table


def _architecture(parameters: Json) -> str:
    """Return the name of a network, its number of classes, and its other parameters."""
    others = {key: value for key, value in parameters.items() if key not in ("name", "class_count")}
    parts = [str(parameters["name"])]
    if "class_count" in parameters:
        parts.append(f"{parameters['class_count']} classes")
    parts += [f"{_name(key)} {_rounded(value)}" for key, value in others.items()]
    return ", ".join(parts)


def _error_rows(scores: Json) -> dict[str, str]:
    """Return rows about an error model: its scans, and its scores on held-out ones."""
    fitted_to = str(scores.get("fitted_to", ABSENT))
    sequences = scores.get("sequences")
    if sequences:
        scans = counted(scores["scans"], "scan") if "scans" in scores else "sequences"
        fitted_to += f" ({scans} of {first_few(sequences)})"
    shares = {"wrong": "wrong", "several": "skipped, with labels of several merged classes"}
    parts = [f"{percent(scores[key])} % {text}" for key, text in shares.items() if scores.get(key)]
    points = [counted(scores["points"], "point")] if "points" in scores else []
    folds = scores.get("folds")
    held_out = f" on {counted(folds, 'fold')} of held-out scans" if folds else ""
    return {
        "error model, fitted to": fitted_to,
        "points of the error model": ", ".join([*points, *parts]),
        "inherited from": str(scores.get(INHERITED, "")),
        f"error model{held_out}": _named(scores.get("error") or {}) or ABSENT,
        "the error model before": _named(scores.get("existing") or {}),
        "confidence, to compare": _named(scores.get("confidence") or {}),
    }


def _named(scores: Json) -> str:
    """Return names and rounded scores: further digits depend on a few scans."""
    return ", ".join(f"{_name(key)} {_rounded(value)}" for key, value in scores.items())


def _name(key: str) -> str:
    """Return the name of a key of a card."""
    if key in SCORE_NAMES:
        return SCORE_NAMES[key]
    if key.startswith(IOU):
        return f"IoU of {key.removeprefix(IOU)}"
    return key.replace("_", " ")


def _rounded(value: Any) -> str:
    """Return a score, or several with or without names, as text."""
    if isinstance(value, Mapping):
        return f"({_named(value)})"
    if isinstance(value, list):
        return " ".join(map(str, value))
    return f"{value:.3f}" if isinstance(value, float) else str(value)
