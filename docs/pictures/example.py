# SPDX-License-Identifier: MIT
"""One scan of the drive that training has not seen, with all that the concepts show of it."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from measurements import percent, salsanext
from prepared import predicted_drive

import salsanext_cli as sn

SCAN = "000059"
"""First scan of the drive."""
TRUTH = "pandaset/sequences/002/labels"
WIDTHS = (256, 512, 1024, 2048)
FAR_M = 1.0
"""Distance behind the nearest point of a pixel from which another surface is likely."""

Values = npt.NDArray[Any]


@dataclass(frozen=True)
class Example:
    """A scan with its labels and uncertainties."""

    scan: sn.Scan
    network: sn.Network
    image: sn.RangeImage
    pixel_labels: Values  # (H, W) train ids
    labels: Values  # (N,) uint8, train ids, after the vote
    truth: Values  # (N,) train ids; 0 where it is not known
    uncertainty: dict[str, Values]  # (N,) float32 by kind

    @property
    def before_vote(self) -> Values:
        """Label of the pixel of each point, (N,) train ids."""
        pixels = self.image.pixel_of_point
        return np.where(pixels >= 0, self.pixel_labels.ravel()[pixels], 0)

    @property
    def wrong(self) -> Values:
        """Whether the truth of each point is known, and another one than its label, (N,) bool."""
        return (self.truth > 0) & (self.labels != self.truth)


@cache
def example(data: Path) -> Example:
    """Predict the drive and return one scan of it."""
    space = sn.label_space()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        _, results = predicted_drive(data, folder, "--error")
        salsanext("uncertainty", folder / "drive", folder / "out", "--limit", 1)
        kinds = {
            kind.name: np.load(kind / f"{SCAN}.npy") for kind in (results / "uncertainty").iterdir()
        }
        scan = sn.read_scan(folder / "drive" / f"{SCAN}.bin")
        network = sn.fit_network(sn.load_network(), folder / "drive")
    image = sn.project(scan, network.sensor)
    pixel_labels = network.probabilities(image).argmax(axis=0)
    labels = sn.knn_refine(image, pixel_labels)
    truth = space.to_train(sn.read_labels(data / TRUTH / f"{SCAN}.label"))
    return Example(
        scan=scan,
        network=network,
        image=image,
        pixel_labels=pixel_labels,
        labels=labels,
        truth=truth,
        uncertainty=kinds,
    )


def behind(image: sn.RangeImage) -> Values:
    """Return how far each point lies behind the nearest one of its pixel, in metres, (N,)."""
    pixels = image.pixel_of_point
    nearest = image.channels[0].ravel()[pixels]
    return np.where(pixels >= 0, image.point_range - nearest, 0)


def hidden_shares(data: Path, width: int) -> tuple[float, float]:
    """Return the shares of points that share a pixel, and that lie far behind, at a width."""
    shown = example(data)
    sensor = shown.network.sensor
    image = sn.project(shown.scan, sensor.resized(sensor.height, width))
    pixels = image.pixel_of_point
    points = (pixels >= 0).sum()
    occupied = (image.point_of_pixel >= 0).sum()
    return 1 - occupied / points, (behind(image) > FAR_M).sum() / points


def measured(data: Path) -> dict[str, str]:
    """Return the figures of the captions."""
    shown = example(data)
    known = (shown.truth > 0) & (shown.labels > 0)
    changed = known & (shown.labels != shown.before_vote)
    return {
        **{f"shared_{width}": percent(hidden_shares(data, width)[0]) for width in WIDTHS},
        **{f"behind_{width}": percent(hidden_shares(data, width)[1]) for width in WIDTHS},
        "changed": percent(changed.sum() / known.sum()),
        "repaired": percent((shown.labels == shown.truth)[changed].mean()),
        "broken": percent((shown.before_vote == shown.truth)[changed].mean()),
    }
