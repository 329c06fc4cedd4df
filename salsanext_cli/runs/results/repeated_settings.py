# SPDX-License-Identifier: MIT
"""Settings of the run in a folder, as a command that continues or repeats it must have them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.wording import setting
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.weights.card_file import default_weights
from salsanext_cli.runs.results.manifest import Manifest, StageRecord
from salsanext_cli.runs.results.provenance import Provenance

NETWORK_STAGES = ("predict", "uncertainty")
"""Stages whose records have the settings of a network, the first one decides."""
SETTINGS_OF_LABELS = ("classes", "origin")
"""Settings of a network that only commands which label scans take."""
UNKNOWN_WEIGHTS = "WEIGHTS"
"""Word for weights that a run does not record, and that were moved since."""


def settings_of_network(
    records: Manifest, omitted: Collection[str] = SETTINGS_OF_LABELS
) -> list[str]:
    """Return the settings that the network of a run was given, as `setting` spells them.

    Parameters
    ----------
    records : Manifest
        Records of the run.
    omitted : collection of str
        Settings that the command does not take, or must not repeat.

    Returns
    -------
    list of str
    """
    record = network_record(records)
    if record is None:
        return []
    options = {name: value for name, value in record.options.items() if name not in omitted}
    return [*_weights(records, record), *settings_as_typed(options)]


def settings_as_typed(options: Mapping[str, object]) -> list[str]:
    """Return settings by argument as `setting` spells them, with paths of the current folder."""
    return [setting(name, _value_as_typed(value)) for name, value in options.items()]


def settings_of_run(records: Manifest, omitted: Collection[str] = ()) -> list[str]:
    """Return the settings of `settings_of_network`, and those of the vote of the neighbours."""
    settings = settings_of_network(records, omitted)
    recorded = records.settings("predict") or records.settings("uncertainty")
    knn = recorded.knn if recorded else None
    if knn is None:
        return settings
    defaults = KnnParameters()
    for field in fields(KnnParameters):
        value = getattr(knn, field.name)
        if value != getattr(defaults, field.name):
            settings.append(setting(f"knn.{field.name}", value))
    return settings


def extras_of_run(records: Manifest, extras: tuple[str, ...]) -> list[str]:
    """Return the settings for further results of `predict`, with those that its labels have."""
    prediction = Provenance(records.root).prediction()
    settings: list[str] = []
    if prediction and prediction.reject is not None:
        settings.append(setting("reject", "risk" if prediction.guarantee else prediction.reject))
    if prediction and prediction.objects:
        extras = ("objects", *extras)
    return [*settings, setting("extras", extras)] if extras else settings


def path_as_typed(path: Path) -> Path:
    """Return a path relative to the current folder if it is in it, else absolute."""
    absolute = path.absolute()
    here = Path.cwd()
    return absolute.relative_to(here) if absolute.is_relative_to(here) else absolute


def _value_as_typed(value: object) -> object:
    """Return a value of JSON as an argument: an absolute path as it is typed in this folder."""
    if isinstance(value, list | tuple):
        return tuple(_value_as_typed(item) for item in value)
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, str) and Path(value).is_absolute():
        return path_as_typed(Path(value))
    return value


def network_record(records: Manifest) -> StageRecord | None:
    """Return the record of the stage that ran the network, None without any."""
    recorded = [records.record(stage) for stage in NETWORK_STAGES]
    return next((record for record in recorded if record), None)


def _weights(records: Manifest, record: StageRecord) -> list[str]:
    """Return the setting of the weights of a run; empty for the default weights."""
    settings = records.settings(record.stage)
    weights = getattr(settings, "weights", None)
    if weights is None:
        return []
    # An installation without its weights still shows results.
    with suppress(SalsanextError):
        if fingerprint(default_weights()) == weights:
            return []
    with suppress(SalsanextError):
        path = Path(record.weights_file)
        if record.weights_file and fingerprint(path) == weights:
            return [setting("weights", path_as_typed(path))]
    return [setting("weights", UNKNOWN_WEIGHTS)]
