# SPDX-License-Identifier: MIT
"""Labels of the scans of a drive by all scans that see the same locations, in memory."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.fusion.reach import FusionReach
from salsanext_cli.core.fusion.top_classes import softmax_of
from salsanext_cli.core.fusion.window import FusionWindow
from salsanext_cli.core.records import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VotingScan:
    """Labelled scan whose points vote.

    Attributes
    ----------
    points : callable
        Returns the points (N, 3) float32 in metres, in the frame that its pose is for. They are
        read for each scan once while the window around it moves along the drive.
    labels : (N,) uint8
        Train ids.
    votes : (N, 3) uint16
        Most probable classes, as of `top_classes`.
    """

    points: Callable[[], Float]
    labels: TrainIds
    votes: npt.NDArray[np.uint16]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FusedLabels:
    """Labels of a scan by all scans that see its points.

    Attributes
    ----------
    labels : (N,) uint8
        Train ids.
    disagreement : (N,) float32
        Share of the votes against the label, NaN without any.
    """

    labels: TrainIds
    disagreement: Float


def fuse_drive(
    scans: Sequence[VotingScan], drive: Drive, space: LabelSpace, reach: FusionReach = FusionReach()
) -> Iterator[FusedLabels | SalsanextError]:
    """Fuse the labels of the scans of a drive.

    Parameters
    ----------
    scans : sequence of VotingScan
        Scans in the order of the drive.
    drive : Drive
        Their poses.
    space : LabelSpace
        Classes of the labels, and which of them are movable.
    reach : FusionReach
        Scans that vote.

    Yields
    ------
    FusedLabels or SalsanextError
        Labels of each scan in order, or the reason why it has none.
    """

    def read(number: int) -> tuple[Float, Float]:
        scan = scans[number]
        return scan.points(), softmax_of(scan.votes, space.class_count)

    window = FusionWindow(drive, read, reach, space.movable)
    for number, scan in enumerate(scans):
        try:
            tally = window.tally(number)
        except SalsanextError as error:
            yield error
            continue
        labels = tally.fused(scan.labels)
        yield FusedLabels(labels=labels, disagreement=tally.disagreement(labels))
