# SPDX-License-Identifier: MIT
"""Stage `tune error`: the probability that a label is wrong, fitted on labelled scans."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import TrainingError, counted
from salsanext_cli.geometry.knn import knn_refine
from salsanext_cli.inference.network import Network
from salsanext_cli.inference.scan_fit import fitted
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.network.card import require_tensors
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.parallel.run import Progress
from salsanext_cli.records import Float
from salsanext_cli.storage.files.atomic import require_target
from salsanext_cli.storage.layout import ScanFile, find_scans
from salsanext_cli.storage.selection import ScanSelection
from salsanext_cli.training.cross_validation import folds
from salsanext_cli.training.tuning.error import JudgedPoints, error_scores, fit_error
from salsanext_cli.training.tuning.labelled_images import (
    VALIDATION,
    labelled_scans,
    read_labelled_image,
    require_points,
)
from salsanext_cli.uncertainty.error_features import FEATURES, error_features
from salsanext_cli.uncertainty.monte_carlo import scan_seed

MAX_POINTS = 1_000_000
"""Bound of the number of points that are kept, 48 MB."""
MAX_POINTS_OF_SCAN = 20_000
"""Points of one scan are much alike: more of them tell little."""
FOLDS = 5
SEED = 0
"""Seed of the choice of points that are kept, and of the fit."""

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

    Parameters
    ----------
    dataset : Path
        Labelled scans that the network was not trained on.
    target : Path
        The `.safetensors` file to write: the same tensors, bit for bit.
    network : NetworkSettings
        Weights, device and sensor.
    selection : ScanSelection
        Which scans; a limit takes scans that are evenly spaced.
    overwrite : bool
        Whether the target may exist.
    progress : callable, optional
        Called after each scan.

    Returns
    -------
    dict
        JSON-able: the number of `scans`, `sequences`, `folds` and `points`, the share of wrong ones
        `wrong`, and for points of scans left out the scores `error` of the model and `confidence`
        of 1 − the probability of the label: `auroc`, `aurc`, `ece` and `risk_80`, the share of
        wrong points among the best 80 %. Both are None of a single scan.

    Raises
    ------
    SalsanextError
        If the scans cannot be learnt from, or the file cannot be written.
    """
    require_tensors(network.path)
    loaded = network.load()
    scans, space = labelled_scans(dataset, selection, loaded.card)
    require_target(target, overwrite)
    loaded = fitted(network, loaded, find_scans(dataset))
    network.announce(loaded)
    most = max(1, min(MAX_POINTS_OF_SCAN, MAX_POINTS // len(scans)))
    judged: dict[ScanFile, JudgedPoints] = {}
    for number, file in enumerate(scans, start=1):
        judged[file] = judged_points(file, loaded, space, most)
        if progress:
            progress(number, len(scans))
    wrong = np.concatenate([points.wrong for points in judged.values()])
    require_points(len(wrong), dataset, space)
    if wrong.all() or not wrong.any():
        found = f"{'every' if wrong.all() else 'no'} label of {len(wrong)} points is wrong"
        expected = "right and wrong ones"
        raise TrainingError(dataset, found, expected, "use more scans, or other weights")
    scores = _scores_left_out(judged)
    model = fit_error(FEATURES, list(judged.values()), SEED)
    summary: dict[str, Any] = {
        "scans": len(scans),
        "sequences": len({file.sequence for file in scans}),
        "points": len(wrong),
        "wrong": float(wrong.mean()),
        **scores,
    }
    save_with_card(network.path, target, replace(loaded.card, error=replace(model, scores=summary)))
    return {"stage": "tune error", **summary}


def judged_points(file: ScanFile, network: Network, space: LabelSpace, most: int) -> JudgedPoints:
    """Predict a labelled scan as `predict` does, and judge a random sample of its points."""
    labelled = read_labelled_image(file, network, space)
    probabilities = network.probabilities(labelled.image, file.path)
    pixel_labels = probabilities.argmax(axis=0)
    labels = knn_refine(labelled.image, pixel_labels, space.class_count, device=network.device)
    features = error_features(labelled.image, probabilities, labels)
    random = np.random.default_rng(scan_seed(SEED, file.sequence, file.stem))
    count = len(labelled.truth)
    chosen = random.permutation(count)[:most]
    points = labelled.points[chosen]
    return JudgedPoints(
        features=features[points],
        confidence=features[points, FEATURES.index("probability of the label")],
        wrong=labels[points] != labelled.truth[chosen],
    )


def _scores_left_out(judged: dict[ScanFile, JudgedPoints]) -> dict[str, Any]:
    """Fit without each fold of the scans, and score all points by the models that lack them."""
    parts = folds(list(judged), FOLDS) if len(judged) > 1 else []
    errors, left_out = list[Float](), list[JudgedPoints]()
    for part in parts:
        others = [points for file, points in judged.items() if file not in part]
        if len({*np.concatenate([points.wrong for points in others]).tolist()}) == 1:
            log.warning("without %s every label is right, or every one wrong", part[0].sequence)
            parts = []
            break
        model = fit_error(FEATURES, others, SEED)
        left_out += [judged[file] for file in part]
        errors += [model.probability(judged[file].features) for file in part]
    if not parts:
        log.warning("%s: not cross-validated", counted(len(judged), "scan"))
        return {"folds": 0, "error": None, "confidence": None}
    wrong = np.concatenate([points.wrong for points in left_out])
    doubt = 1 - np.concatenate([points.confidence for points in left_out])
    return {
        "folds": len(parts),
        "error": error_scores(np.concatenate(errors), wrong),
        "confidence": error_scores(np.clip(doubt, 0, 1), wrong),
    }
