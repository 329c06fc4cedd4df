# SPDX-License-Identifier: MIT
"""Search for objects of classes that weights were not trained on, by each kind of uncertainty.

The novelty model is fitted to one labelled data set without those classes, and judged on another,
pixel by pixel: AUROC, and the share of known points above the value that 95 % of the new ones
exceed (FPR95), for each new class beside all known ones. The weights must not know the classes.

Run: python benchmarks/novelty.py weights.safetensors fitted-to/ judged-on/ motorcycle motorcyclist
     [--limit 20]
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

import salsanext_cli as sn
from salsanext_cli.inference.network import Network
from salsanext_cli.storage.selection import ScanSelection, select_evenly
from salsanext_cli.training.tuning.labelled_images import (
    LabelledImage,
    of_points,
    read_labelled_image,
)
from salsanext_cli.training.tuning.novelty import ClassMoments
from salsanext_cli.uncertainty.monte_carlo import sample
from salsanext_cli.uncertainty.scan_description import pixel_features

Values = npt.NDArray[np.floating]
PASSES = 15


def labelled(network: Network, dataset: Path, limit: int) -> Iterator[LabelledImage]:
    """Yield the labelled scans of a data set, at most some that are evenly spaced."""
    for file in select_evenly(dataset, ScanSelection(limit=limit), network.space):
        yield read_labelled_image(file, network, network.space)


def scores(network: Network, moments: ClassMoments, scan: LabelledImage) -> dict[str, Values]:
    """Return every score of each labelled point; the higher, the more likely it is new."""
    model = moments.model()
    assert model is not None
    logits = of_points(network.logits(scan.image), scan).astype(np.float64)
    softmax = np.exp(logits - logits.max(axis=1, keepdims=True))
    softmax /= softmax.sum(axis=1, keepdims=True)
    dropped = sample(network, scan.image, samples=PASSES, seed=0).uncertainty
    return {
        "max-logit": -logits.max(axis=1),
        "confidence": 1 - softmax.max(axis=1),
        "softmax entropy": -(softmax * np.log(np.maximum(softmax, 1e-300))).sum(axis=1),
        "mutual information": of_points(dropped.mutual_information[None], scan)[:, 0],
        "novelty": model.distance(of_points(pixel_features(network, scan.image), scan)),
    }


def separation(values: Values, new: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Return AUROC and FPR95 of finding the new points by high values."""
    known, found = np.sort(values[~new]), values[new]
    below = sum(np.searchsorted(known, found, side) for side in ("left", "right"))
    return below.mean() / (2 * len(known)), (known >= np.quantile(found, 0.05)).mean()


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("weights")
    parser.add_argument("fitted_to", type=Path)
    parser.add_argument("judged_on", type=Path)
    parser.add_argument("classes", nargs="+")
    parser.add_argument("--limit", type=int, default=20)
    given = parser.parse_args(words or None)
    network = sn.load_network(given.weights, device="cpu")
    places = [network.space.names.index(name) for name in given.classes]
    moments = ClassMoments(network.space.class_count)
    for scan in labelled(network, given.fitted_to, given.limit):
        known = ~np.isin(scan.truth, places)
        features = of_points(pixel_features(network, scan.image), scan)
        moments.add(features[known], scan.truth[known])
    found = [
        (scores(network, moments, scan), scan.truth)
        for scan in labelled(network, given.judged_on, given.limit)
    ]
    truth = np.concatenate([each for _, each in found])
    for place, name in zip(places, given.classes, strict=True):
        kept = ~np.isin(truth, places) | (truth == place)
        new = truth[kept] == place
        for kind in found[0][0]:
            values = np.concatenate([each[kind] for each, _ in found])[kept]
            auroc, fpr = separation(values, new)
            print(f"{name}, {new.sum():,} points, {kind}  {auroc:.3f}  {fpr:.3f}", flush=True)


if __name__ == "__main__":
    main()
