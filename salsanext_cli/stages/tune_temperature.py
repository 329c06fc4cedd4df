# SPDX-License-Identifier: MIT
"""Stage `tune temperature`: the temperature of a network, fitted on labelled scans."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import reduce
from operator import iadd
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import NOTICE, TrainingError, WeightsError
from salsanext_cli.files.atomic import require_target
from salsanext_cli.fitting.scan_fit import fitted
from salsanext_cli.measures.calibration import calibration_scores
from salsanext_cli.measures.histograms import confidence_histogram, softmax_errors
from salsanext_cli.network.card import TEMPERATURES, require_tensors
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.parallel.run import Progress
from salsanext_cli.records import Float
from salsanext_cli.results.layout import ScanFile, find_scans
from salsanext_cli.results.selection import ScanSelection
from salsanext_cli.training.tuning.labelled_images import (
    VALIDATION,
    labelled_scans,
    read_labelled_image,
    require_points,
)
from salsanext_cli.training.tuning.temperature import (
    best_temperature,
    chunks,
    negative_log_likelihood,
)
from salsanext_cli.uncertainty.monte_carlo import scan_seed

MAX_LOGITS = 20_000_000
"""Bound of the number of logits that are kept, 80 MB: a million points with 20 classes."""
SEED = 0
"""Seed of the choice of points that are kept."""

log = logging.getLogger(__name__)


def tune_temperature(
    dataset: Path,
    target: Path,
    *,
    network: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = VALIDATION,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write a weights file with the temperature of the least negative log-likelihood.

    Each point has the logits of its pixel, as for `predict --probabilities`; points of ignored
    classes do not count. Of a scan with more points than its share of `MAX_LOGITS`, a random sample
    is taken, the same one every time.

    `dataset`: labelled scans that the network was not trained on; `target`: the `.safetensors` file
    to write: the same tensors, bit for bit; `network`: weights, device and sensor; `selection`:
    which scans; a limit takes scans that are evenly spaced; `overwrite`: whether the target may
    exist; `progress`: called after each scan.

    Returns plain data: with the temperature that the weights had, `before`, and with the one that
    was fitted, `after`, the `temperature`, the mean negative log-likelihood of the true class in
    nats, `nll`, and the expected calibration error over 15 bins, `ece`, 0…1; the number of `scans`
    and of `points` fitted to.
    """
    require_tensors(network.path)
    loaded = network.load()
    scans, space = labelled_scans(dataset, selection, loaded.card)
    require_target(target, overwrite)
    loaded = fitted(network, loaded, find_scans(dataset))
    network.announce(loaded)
    most = max(1, MAX_LOGITS // loaded.card.space.class_count // len(scans))
    kept = list(_samples(scans, loaded, space, most, progress))
    logits = torch.from_numpy(np.concatenate([values for values, _ in kept]))
    truth = torch.from_numpy(np.concatenate([classes for _, classes in kept])).long()
    require_points(len(truth), dataset, space)
    temperature = best_temperature(logits, truth)
    _require_possible(dataset, temperature, len(truth))
    if loaded.card.error:
        log.log(NOTICE, "the error model is left out: fit it anew with `salsanext tune error`")
    card = replace(loaded.card, temperature=temperature, error=None)
    save_with_card(network.path, target, card)
    return {
        "stage": "tune temperature",
        "before": _tempered(logits, truth, loaded.card.temperature),
        "after": _tempered(logits, truth, temperature),
        "scans": len(scans),
        "points": len(truth),
    }


def _samples(
    scans: Sequence[ScanFile],
    network: Network,
    space: LabelSpace,
    most: int,
    progress: Progress | None,
) -> Iterator[tuple[Float, Any]]:
    """Yield the logits (M, C) and train ids (M,) of at most so many points of each scan."""
    for number, file in enumerate(scans, start=1):
        labelled = read_labelled_image(file, network, space)
        logits = network.logits(labelled.image).reshape(space.class_count, -1)
        if not np.isfinite(logits).all():
            raise WeightsError(file.path, "the network's logits are not finite", "finite ones")
        random = np.random.default_rng(scan_seed(SEED, file.sequence, file.stem))
        count = len(labelled.truth)
        chosen = random.choice(count, most, replace=False) if count > most else slice(None)
        log.info("%s/%s: %d points", file.sequence, file.stem, min(count, most))
        yield logits[:, labelled.pixels[chosen]].T.copy(), labelled.truth[chosen]
        if progress:
            progress(number, len(scans))


def _require_possible(dataset: Path, temperature: float, points: int) -> None:
    """Refuse a temperature that no softmax can be used with."""
    lowest, highest = TEMPERATURES
    if temperature == 0:
        found = f"each of {points} points is right: the lower, the better"
    elif temperature == float("inf"):
        found = f"{points} points whose classes the network does not know: the higher, the better"
    else:
        found = f"the best temperature is {temperature:g}"
    if not lowest <= temperature <= highest:
        expected = f"one between {lowest:g} and {highest:g}"
        raise TrainingError(dataset, found, expected, "use more scans, or other weights")


def _tempered(logits: Tensor, truth: Tensor, temperature: float) -> dict[str, float]:
    errors = (
        softmax_errors(torch.softmax(part / temperature, dim=1).numpy(), classes.numpy())
        for part, classes in chunks(logits, truth)
    )
    one_group = (confidence_histogram(e, np.zeros(len(e.wrong), np.intp), 1) for e in errors)
    histogram = reduce(iadd, one_group)
    nll = negative_log_likelihood(logits, truth, temperature)
    return {"temperature": temperature, "nll": nll, "ece": calibration_scores(histogram).ece}
