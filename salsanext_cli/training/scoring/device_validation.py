# SPDX-License-Identifier: MIT
"""Validation of scans on a GPU that the training has: only confusions and a sample come back."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import torch
import torch.nn.functional as F
from torch import Tensor

from salsanext_cli.core.engines.backend import device_backend
from salsanext_cli.core.engines.device_copies import HostCopies, device_numbers, pinned
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.on_device.host_points import HostPoints
from salsanext_cli.core.on_device.knn import knn_refine
from salsanext_cli.core.on_device.network_input import network_inputs
from salsanext_cli.core.on_device.projection import project
from salsanext_cli.core.on_device.scan_batch import ScanBatch
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training.data.sources import Source, read_labelled
from salsanext_cli.training.scoring.validated_scan import MAX_VALIDATED_POINTS, ValidatedScan


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LabelledPoints:
    """Points of a scan that the device reads, with its sensor.

    Attributes
    ----------
    points : HostPoints
        N points.
    truth : (N,) uint8
        True train ids.
    sensor : Sensor
        Sensor of the scan.
    """

    points: HostPoints
    truth: Tensor
    sensor: Sensor


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SampledPoints:
    """Sample of the points of B scans, with K places each.

    Attributes
    ----------
    point : (B, K) int64
        Index of a point among those of all scans.
    count : (B,) int64
        Number of places that are taken, the first ones.
    """

    point: Tensor
    count: Tensor


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ComputedScan:
    """Scan whose results are on their way from the device.

    Attributes
    ----------
    batch : HostCopies
        Of B scans: confusions (B, C, C), logits (B, C, K) and truth (B, K) of sampled points, the
        number of these points (B,), and whether the logits of all pixels are finite (B,).
    number : int
        Number of the scan in the batch.
    """

    batch: HostCopies
    number: int

    def validated(self) -> ValidatedScan:
        """Wait for the results, and return copies of those of the scan."""
        arrays = self.batch.arrays()
        confusion, logits, truth, count, is_finite = (array[self.number] for array in arrays)
        return ValidatedScan(
            confusion=confusion.copy(),
            logits=torch.from_numpy(logits[:, :count].copy()),
            truth=torch.from_numpy(truth[:count].copy()),
            is_finite=bool(is_finite),
        )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DeviceValidation:
    """Job that validates the scans of a source on the device of a network in torch.

    Attributes
    ----------
    network : Network
        Network of the present weights.
    source : Source
        All scans of the validation.
    """

    network: Network
    source: Source

    def prepare(self, file: ScanFile) -> LabelledPoints:
        """Read a scan and its labels, and copy the points for the device."""
        fitted = self.network.for_sensor(self.source.sensor_of(file))
        annotated = read_labelled(file, self.source.space, fitted.sensor)
        return LabelledPoints(
            points=HostPoints.from_scan(annotated.scan, self.network.device),
            truth=torch.from_numpy(annotated.labels),
            sensor=sensor_of(annotated.scan, fitted.sensor),
        )

    @torch.inference_mode()
    def compute(self, scans: Sequence[LabelledPoints]) -> list[ComputedScan]:
        """Label the points of scans together, and compare the labels with the truth.

        The host does not wait, so that the device has the next batch before this one is back.
        """
        backend = device_backend(self.network.backend)
        device = torch.device(self.network.device)
        sensors = [scan.sensor for scan in scans]
        batch = ScanBatch.on_device([scan.points for scan in scans], sensors, str(device))
        host_truth = pinned(torch.cat([scan.truth for scan in scans]), device)
        truth = host_truth.to(device, non_blocking=True).long()
        images = project(batch)
        inputs = network_inputs(images.channels, sensors, self.network.card.sensor)
        logits = backend.device_logits(inputs)
        labels = knn_refine(images, logits.argmax(dim=1).to(torch.uint8), KnnParameters())
        space = self.network.card.space
        is_scored = device_numbers(space.scored, device, torch.bool)[truth]
        is_usable = is_scored & (images.pixel_of_point >= 0)
        sample = sampled_points(is_usable, batch.counts, len(self.source.files))
        pixel = images.pixel_of_point[sample.point].clamp(min=0) % logits[0, 0].numel()
        index = pixel[:, None].expand(-1, logits.shape[1], -1)
        results = HostCopies.of(
            [
                confusions(truth, labels, batch, space.class_count),
                logits.flatten(2).gather(2, index),
                truth[sample.point],
                sample.count,
                logits.isfinite().flatten(1).all(dim=1),
            ]
        )
        return [ComputedScan(batch=results, number=number) for number in range(len(scans))]

    def finish(self, scan: LabelledPoints, computed: ComputedScan) -> ValidatedScan:
        """Wait for the results of a scan."""
        return computed.validated()


def confusions(truth: Tensor, labels: Tensor, batch: ScanBatch, class_count: int) -> Tensor:
    """Return the confusion of each scan of a batch.

    Parameters
    ----------
    truth : (P,) int64
        True train ids of the points.
    labels : (P,) uint8
        Predicted train ids.
    batch : ScanBatch
        B scans of the points.
    class_count : int
        C.

    Returns
    -------
    (B, C, C) int64
        Number of points by true and predicted class.
    """
    cell = (batch.scan_of_point * class_count + truth) * class_count + labels
    size = (len(batch.counts), class_count, class_count)
    counts = cell.new_zeros(size)
    counts.view(-1).scatter_add_(0, cell, torch.ones_like(cell))
    return counts


def sampled_points(is_usable: Tensor, counts: Sequence[int], scans: int) -> SampledPoints:
    """Return every so many of the usable points of scans, as of `sample_interval`.

    Parameters
    ----------
    is_usable : (P,) bool
        Whether a point may be chosen.
    counts : sequence of int
        Number of points of each scan, with sum P.
    scans : int
        Number of scans of the validation.

    Returns
    -------
    SampledPoints
    """
    device = is_usable.device
    rank = is_usable.cumsum(dim=0)
    bounds = device_numbers([0, *accumulate(counts)], device, torch.int64)
    before = F.pad(rank, (1, 0))[bounds]
    usable = before.diff()
    interval = (usable * scans // MAX_VALIDATED_POINTS).clamp(min=1)
    # An interval above one leaves at most two thirds of this number.
    places = min(max(counts), 2 * MAX_VALIDATED_POINTS // scans + 2)
    place = torch.arange(places, device=device) * interval[:, None]
    # A place that is not taken has any point.
    point = torch.searchsorted(rank, before[:-1, None] + place + 1).clamp(max=len(rank) - 1)
    count = torch.div(usable + interval - 1, interval, rounding_mode="floor")
    return SampledPoints(point=point, count=count)
