# SPDX-License-Identifier: MIT
"""Scans to validate on, and their validation: confusion on points, after kNN."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from salsanext_cli.classes import LabelSpace
from salsanext_cli.geometry.knn import knn_refine
from salsanext_cli.geometry.projection import project
from salsanext_cli.inference.network import Network
from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.storage.selection import ScanSelection, select_scans
from salsanext_cli.training.dataset import read_labelled


def evenly_spaced(files: Sequence[ScanFile], count: int) -> list[ScanFile]:
    """Return `count` of the files, evenly spaced; all if `count` is 0 or there are no more."""
    if count == 0 or count >= len(files):
        return list(files)
    return [files[i] for i in np.linspace(0, len(files) - 1, count).round().astype(int)]


def select_evenly(source: Path, selection: ScanSelection, space: LabelSpace) -> list[ScanFile]:
    """Find the scans of a selection, as `select_scans`; a limit takes evenly spaced ones."""
    scans = select_scans(source, replace(selection, limit=None), space)
    return evenly_spaced(scans, selection.limit or 0)


def validate(network: Network, files: Sequence[ScanFile]) -> Confusion:
    """Predict labelled scans as `predict` does and count truth against prediction."""
    space = network.card.space
    confusion = Confusion(space.class_count)
    for file in files:
        scan, truth = read_labelled(file, space, network.sensor)
        image = project(scan, network.sensor)
        pixel_labels = network.probabilities(image).argmax(axis=0)
        confusion.update(truth, knn_refine(image, pixel_labels, space.class_count))
    return confusion
