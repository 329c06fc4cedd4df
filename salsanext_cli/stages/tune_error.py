# SPDX-License-Identifier: MIT
"""Stage `tune error`: the probability that a label is wrong, fitted on labelled scans."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import TrainingError
from salsanext_cli.files.atomic import require_target
from salsanext_cli.fitting.scan_fit import fitted
from salsanext_cli.network.card import require_tensors
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.parallel.run import Progress
from salsanext_cli.results.layout import ScanFile, find_scans
from salsanext_cli.results.selection import ScanSelection
from salsanext_cli.training.cross_validation import folds
from salsanext_cli.training.tuning.error import FOLDS, cross_validated, gains, of_both_kinds
from salsanext_cli.training.tuning.judged_points import (
    JudgedPoints,
    judged_points,
    points_of_scan,
)
from salsanext_cli.training.tuning.labelled_images import (
    VALIDATION,
    labelled_scans,
    require_points,
)

log = logging.getLogger(__name__)


def tune_error(
    dataset: Path,
    target: Path,
    *,
    network: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = VALIDATION,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write a weights file with a model of the probability that a point's label is wrong.

    The label is the one of `predict`, after kNN. The model is cross-validated over whole sequences,
    or over neighbouring scans of a single one, and then fitted to all scans.

    `dataset`: labelled scans that the network was not trained on; `target`: the `.safetensors` file
    to write: the same tensors, bit for bit; `network`: weights, device and sensor; `selection`:
    which scans; a limit takes scans that are evenly spaced; `overwrite`: whether the target may
    exist; `progress`: called after each scan.

    Returns plain data: the scores of the model, see `training.tuning.error.cross_validated`.
    """
    require_tensors(network.path)
    loaded = network.load()
    scans, space = labelled_scans(dataset, selection, loaded.card)
    require_target(target, overwrite)
    loaded = fitted(network, loaded, find_scans(dataset))
    network.announce(loaded)
    most = points_of_scan(len(scans))
    judged: dict[ScanFile, JudgedPoints] = {}
    for number, file in enumerate(scans, start=1):
        judged[file] = judged_points(file, loaded, space, most)
        if progress:
            progress(number, len(scans))
    wrong = np.concatenate([points.wrong for points in judged.values()])
    require_points(len(wrong), dataset, space)
    if not of_both_kinds(judged.values()):
        found = f"{'every' if wrong.all() else 'no'} label of {len(wrong)} points is wrong"
        expected = "right and wrong ones"
        raise TrainingError(dataset, found, expected, "use more scans, or other weights")
    model = cross_validated(judged, folds(scans, FOLDS) if len(scans) > 1 else [])
    if model.scores["folds"] and not gains(model):
        log.warning("the error is no better than the confidence on scans left out")
    save_with_card(network.path, target, replace(loaded.card, error=model))
    return {"stage": "tune error", **model.scores}
