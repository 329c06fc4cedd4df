# SPDX-License-Identifier: MIT
"""Labelled scans in the classes of a network, point by point, to tune on."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.engines.network import Network
from salsanext_cli.errors import LabelError, first_few
from salsanext_cli.geometry.projection import project
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.options import ScanSelection
from salsanext_cli.records import Float, RangeImage
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.selection import select_evenly, space_of
from salsanext_cli.training.data.class_counts import require_labels
from salsanext_cli.training.data.sources import read_labelled
from salsanext_cli.training.data.targets import class_sets

VALIDATION = ScanSelection(split="valid")
"""Selection of scans to tune on, unless another is given."""


@dataclass(frozen=True, slots=True)
class LabelledImage:
    """Range image of a whole scan, and those of its points that count, M of them.

    Those `points` have a pixel, `pixels` = v * W + u, and a label that stands for one class, not
    ignored: `truth` (M,) uint8.
    """

    image: RangeImage
    points: npt.NDArray[np.intp]
    pixels: npt.NDArray[np.int32]
    truth: TrainIds


def labelled_scans(
    dataset: Path, selection: ScanSelection, card: WeightsCard
) -> tuple[list[ScanFile], LabelSpace]:
    """Find labelled scans whose classes are those of a network; a limit takes them evenly spaced.

    Missing labels, or those of other classes, raise `LabelError`.
    """
    scans = select_evenly(dataset, selection, card.space)
    space = space_of(scans, card.space)
    if not space.fits(card.space):
        raise LabelError(
            dataset,
            f"labels in the classes of {space.name} ({first_few(space.differences(card.space))})",
            f"those of {card.space.name}, as the weights",
            "use weights for these classes",
        )
    require_labels(scans)
    return scans, space


def read_labelled_image(file: ScanFile, network: Network, space: LabelSpace) -> LabelledImage:
    """Read a scan with its labels and project it."""
    scan, targets = read_labelled(file, space, network.sensor, class_sets([space]))
    image = project(scan, network.sensor, network.device)
    scored = np.flatnonzero(space.scored)
    counts = np.flatnonzero(np.isin(targets, scored) & (image.pixel_of_point >= 0))
    return LabelledImage(image, counts, image.pixel_of_point[counts], targets[counts])


def require_points(points: int, dataset: Path, space: LabelSpace) -> None:
    """Raise `LabelError` if there is no point to learn from."""
    if not points:
        raise LabelError(dataset, "no point is of a class that counts", f"labels of {space.name}")


def of_points(of_pixels: Float, labelled: LabelledImage) -> Float:
    """Give every point that counts its pixel's values: (C, H, W) to (M, C)."""
    values: Float = of_pixels.reshape(len(of_pixels), -1)[:, labelled.pixels].T
    return values
