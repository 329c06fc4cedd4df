# SPDX-License-Identifier: MIT
"""Model of errors of a cross-validated training, kept in its run folder."""

import hashlib
import json
import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from salsanext_cli.engines.loading import network_of_module
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.files.json_files import encode_json, read_json
from salsanext_cli.network.error_model import ErrorModel
from salsanext_cli.network.weights import read_weights
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.training.data.class_counts import data_digest
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.run_folder import ERROR, LAST, fold_folder
from salsanext_cli.training.tuning.error import cross_validated, gains, of_both_kinds
from salsanext_cli.training.tuning.judged_points import (
    JudgedPoints,
    judged_points,
    points_of_scan,
)
from salsanext_cli.uncertainty.error_features import FEATURES
from salsanext_cli.version import __version__

log = logging.getLogger(__name__)


def error_of_folds(
    run: Path,
    source: Source,
    parts: Sequence[Sequence[ScanFile]],
    temperature: float,
    place: torch.device,
) -> ErrorModel | None:
    """Return a model of errors on scans that a fold left out, each judged by the fold's weights.

    It is fitted again only if weights or scans are others than those of the one in the run folder.
    There is none where it would tell no more than the confidence.

    `run`: the run folder, with the weights of the folds; `source`: all labelled scans; `parts`:
    those that each fold left out; `temperature`: that of the final weights.
    """
    weights = [fold_folder(run, number) / LAST for number in range(1, len(parts) + 1)]
    inputs = [__version__, FEATURES, temperature, data_digest([source]), *map(fingerprint, weights)]
    kept = read_json(run / ERROR) or {}
    if "error" not in kept or kept.get("sha256") != _checksum(inputs, kept["error"]):
        model = _fitted(weights, source, parts, temperature, place)
        found = model.to_dict() if model else None
        kept = {"error": found, "sha256": _checksum(inputs, found)}
        OwnedFolder(run).write(run / ERROR, encode_json(kept), durable=True)
    if kept["error"] is None:
        log.warning("no model of errors: it would tell no more than the confidence")
        return None
    return ErrorModel.from_dict(kept["error"])


def _checksum(inputs: Sequence[Any], error: Any) -> str:
    return hashlib.sha256(json.dumps([inputs, error]).encode()).hexdigest()


def _fitted(
    weights: Sequence[Path],
    source: Source,
    parts: Sequence[Sequence[ScanFile]],
    temperature: float,
    place: torch.device,
) -> ErrorModel | None:
    judged: dict[ScanFile, JudgedPoints] = {}
    most = points_of_scan(len(source.files))
    for path, part in zip(weights, parts, strict=True):
        module, card = read_weights(path)
        # That of the final weights: the fold's own was fitted to these very scans.
        card = replace(card, temperature=temperature)
        network = network_of_module(module.to(place), card, str(place))
        for file in part:
            own = network.for_sensor(source.sensor_of(file))
            judged[file] = judged_points(file, own, source.space, most)
    model = cross_validated(judged, parts) if of_both_kinds(judged.values()) else None
    return model if model and gains(model) else None
