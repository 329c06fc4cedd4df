# SPDX-License-Identifier: MIT
"""Scans whose labels are judged by their truth, for a threshold of an uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.engines.backend import PixelPrediction
from salsanext_cli.core.errors import LabelError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.labelling import predict_pixels, refine_labels
from salsanext_cli.core.measures.histograms import UNCERTAINTY_BINS, bin_of
from salsanext_cli.core.measures.scores import Counts, Ratios
from salsanext_cli.core.network.card import scan_digest
from salsanext_cli.core.network.unit_traits import UnitTraits
from salsanext_cli.core.uncertainty.error_features import error_probability
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.runs.fit.scan_reading import PreparedFile, read_prepared
from salsanext_cli.runs.loop.job import Steps
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.summary.scan_summary import ScanSummary
from salsanext_cli.training.tuning.scans import NOT_SCORED, TuningScans


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class JudgedScan:
    """Scored points of a scan, counted by the bin of their uncertainty."""

    file: ScanFile
    digest: str
    points: int
    accepted: npt.NDArray[np.int32]  # (B,): points up to each bin
    wrong: npt.NDArray[np.int32]  # (B,): wrong points up to each bin
    traits: UnitTraits | None  # Of all labels, also where the truth is not scored

    @property
    def shares_accepted(self) -> Ratios:
        """Share of the points that each threshold accepts, (B,)."""
        return self.accepted / self.points

    @property
    def shares_wrong(self) -> Ratios:
        """Share of the points that each threshold accepts and that are wrong, (B,)."""
        return self.wrong / self.points


def judged_scans(scans: TuningScans, kind: str, counts: Counts) -> list[JudgedScan]:
    """Label all scans and judge their labels by a kind of uncertainty.

    Parameters
    ----------
    scans : TuningScans
        Scans with their network.
    kind : {"error", "least_confidence"}
    counts : ndarray
        (C, C, B + 1) int64: the points are added by truth, label and bin; the last bin is for
        points without a label.

    Returns
    -------
    list of JudgedScan
        In the order of the scans.

    Raises
    ------
    LabelError
        If no point of a scan has a scored class.
    """
    network = scans.network
    origins = scans.origins

    def prepare(file: ScanFile) -> PreparedFile:
        return read_prepared(file, network, origins.get(file.name))

    def predict(files: Sequence[PreparedFile]) -> list[PixelPrediction]:
        return predict_pixels(network, [file.scan for file in files], softmax=kind == "error")

    judge = partial(judged_scan, space=scans.space, counts=counts)
    return list(scans.run(Steps(prepare=prepare, compute=predict, finish=judge)).values())


def judged_scan(
    prepared: PreparedFile, pixels: PixelPrediction, space: LabelSpace, counts: Counts
) -> JudgedScan:
    """Label a scan as `predict` does, and judge it: by the error if there is a softmax.

    `counts` is as `judged_scans` takes it.
    """
    file = prepared.file
    network = prepared.scan.network
    labelled = refine_labels(prepared.scan, pixels, KnnParameters())
    labels = labelled.labels
    truth = space.to_train(read_labels(file.label_path, len(labels)), source=file.label_path)
    scored = space.scored[truth]
    if not scored.any():
        raise LabelError(file.label_path, NOT_SCORED, f"labels of {space.name}")
    if pixels.softmax is None:
        values = labelled.least_confidence
    else:
        image = prepared.scan.projected.image
        values = error_probability(network, image, pixels.softmax, labels)
    summary = ScanSummary.from_scan(file, labelled, network.space)
    traits = summary.with_traits(labelled, values).traits
    has_label = ~np.isnan(values) & (labels != 0)
    bins = np.where(has_label, bin_of(values), UNCERTAINTY_BINS)[scored]
    scored_truth = truth[scored]
    scored_labels = labels[scored]
    np.add.at(counts, (scored_truth, scored_labels, bins), 1)
    return JudgedScan(
        file=file,
        digest=scan_digest(labelled.checked.scan),
        points=len(scored_truth),
        accepted=_up_to_each_bin(bins),
        wrong=_up_to_each_bin(bins[scored_labels != scored_truth]),
        traits=traits,
    )


def _up_to_each_bin(bins: npt.NDArray[np.intp]) -> npt.NDArray[np.int32]:
    """Return the number of points in each bin and the bins before it, (B,)."""
    counts = np.bincount(bins, minlength=UNCERTAINTY_BINS + 1)
    return counts[:-1].cumsum(dtype=np.int32)
