# SPDX-License-Identifier: MIT
"""Stage `tune novelty`: the features of the known classes, fitted to labelled scans."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.errors import TrainingError
from salsanext_cli.inference.scan_fit import fitted
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.network.card import require_tensors
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.parallel.run import Progress
from salsanext_cli.records import Float
from salsanext_cli.storage.files.atomic import require_target
from salsanext_cli.storage.layout import find_scans
from salsanext_cli.storage.selection import ScanSelection
from salsanext_cli.training.tuning.labelled_images import (
    VALIDATION,
    labelled_scans,
    of_points,
    read_labelled_image,
    require_points,
)
from salsanext_cli.training.tuning.novelty import MIN_POINTS, ClassMoments
from salsanext_cli.uncertainty.scan_description import pixel_features

SAMPLE = 1000
"""Points of each scan that the quantiles are of."""


def tune_novelty(
    dataset: Path,
    target: Path,
    *,
    network: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = VALIDATION,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write a weights file with a model of the features of the classes that it knows.

    Parameters
    ----------
    dataset : Path
        Labelled scans such as the network was trained on, or those themselves.
    target, network, selection, overwrite, progress
        As for `tune_error`.

    Returns
    -------
    dict
        JSON-able: the number of `scans` and `points`, the names of the `classes` that have at least
        200 points, and the distances `median` and `of_99_percent` that a half and 99 % of the
        points do not exceed.

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
    moments, kept = ClassMoments(space.class_count), list[Float]()
    for number, file in enumerate(scans, start=1):
        labelled = read_labelled_image(file, loaded, space)
        features = of_points(pixel_features(loaded, labelled.image), labelled)
        loaded.require_finite(features, file.path)
        moments.add(features, labelled.truth)
        kept.append(features[:: max(1, len(features) // SAMPLE)])
        if progress:
            progress(number, len(scans))
    require_points(int(moments.counts.sum()), dataset, space)
    if (model := moments.model()) is None:
        found = f"no class has {MIN_POINTS} points"
        raise TrainingError(dataset, found, "more labelled points", "use more scans")
    distances = model.distance(np.concatenate(kept))
    median, most = (float(each) for each in np.quantile(distances, (0.5, 0.99)))
    names = np.array(space.names)[moments.counts >= MIN_POINTS]
    scores = {
        "scans": len(scans),
        "points": int(moments.counts.sum()),
        "classes": names.tolist(),
        "median": round(median, 4),
        "of_99_percent": round(most, 4),
    }
    model = replace(model, scores=scores)
    model = replace(model, scores=scores)
    save_with_card(network.path, target, replace(loaded.card, novelty=model))
    return {"stage": "tune novelty", **scores}
