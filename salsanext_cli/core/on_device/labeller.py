# SPDX-License-Identifier: MIT
"""Labels of scans on a device: points are copied there once, and results of points back."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from salsanext_cli.core.engines.backend import DeviceBackend, device_backend
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.engines.torch_backend import merged
from salsanext_cli.core.labelling import LabelledScan, LabelRequest, checked_scan
from salsanext_cli.core.on_device.batch_results import BatchResults, ScanOfBatch, final_results
from salsanext_cli.core.on_device.device_labels import DeviceLabels
from salsanext_cli.core.on_device.error_probability import error_probability
from salsanext_cli.core.on_device.host_points import HostPoints
from salsanext_cli.core.on_device.knn import knn_refine
from salsanext_cli.core.on_device.network_input import network_inputs
from salsanext_cli.core.on_device.projection import (
    RangeImages,
    ego_counts,
    points_from_pixels,
    project,
)
from salsanext_cli.core.on_device.regions import ROUNDS
from salsanext_cli.core.on_device.scan_batch import ScanBatch
from salsanext_cli.core.on_device.scan_for_device import ScanForDevice
from salsanext_cli.core.records import Origin, Scan
from salsanext_cli.core.sensors.sensor import Sensor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DeviceLabeller:
    """Labels scans on the device that computes the network; a `Labeller`.

    Attributes
    ----------
    network : Network
        Network for the sensors of the scans.
    request : LabelRequest
        Results of each scan.
    """

    network: Network
    request: LabelRequest

    def prepare(
        self, scan: Scan, origin: Origin | None = None, source: object = "scan"
    ) -> ScanForDevice:
        """Find the sensor of a scan, check its points, and copy them for the device."""
        network = self.network
        checked = checked_scan(scan, network.sensor, network.card.sensor, origin, source)
        points = HostPoints.from_scan(scan, network.device)
        return ScanForDevice(checked=checked, points=points)

    @torch.inference_mode()
    def compute(self, scans: Sequence[ScanForDevice], rounds: int = ROUNDS) -> list[ScanOfBatch]:
        """Hand scans to the device together, and do not wait for their labels.

        So the device has the next batch before the results of this one are back. For errors, the
        regions of pixels are joined in a number of rounds.
        """
        sensors = [scan.checked.sensor for scan in scans]
        points = [scan.points for scan in scans]
        batch = ScanBatch.on_device(points, sensors, self.network.device)
        images = project(batch)
        softmax = self._softmax(images, sensors)
        confidence, classes = softmax.max(dim=1)
        pixel_labels = classes.to(torch.uint8)
        labels = knn_refine(images, pixel_labels, self.request.knn)
        uncertain = points_from_pixels(1 - confidence[:, None], images, torch.nan)
        point_values = {"labels": labels, "least_confidence": uncertain[:, 0]}
        scan_values = {
            "pixel_labels": pixel_labels,
            "mean_confidence": _mean_confidence(confidence, images),
            "is_finite": confidence.isfinite().flatten(1).all(dim=1),
            "ego_points": ego_counts(batch, images),
        }
        if self.request.softmax:
            point_values["softmax"] = self._softmax_of_points(softmax, images)
        if self.request.error:
            card = self.network.card
            errors = error_probability(images, softmax, labels, card, rounds)
            point_values["error"] = errors.probability
            scan_values["is_final"] = errors.is_final
        results = BatchResults.of(batch.counts, point_values, scan_values)
        return [ScanOfBatch(batch=results, number=number) for number in range(len(scans))]

    @property
    def _backend(self) -> DeviceBackend:
        return device_backend(self.network.backend)

    def _softmax(self, images: RangeImages, sensors: Sequence[Sensor]) -> Tensor:
        """Return the softmax (B, C, H, W) of images, in the classes of the results."""
        network = self.network
        inputs = network_inputs(images.channels, sensors, network.card.sensor)
        softmax = self._backend.softmax(inputs, network.card.temperature)
        return softmax if network.merging is None else merged(softmax, network.merging)

    def _softmax_of_points(self, softmax: Tensor, images: RangeImages) -> Tensor:
        """Return the softmax (B, C, H, W) of the pixels of points, (P, C); else class 0."""
        rows = points_from_pixels(softmax, images, 0.0)
        rows[:, 0].masked_fill_(images.pixel_of_point < 0, 1)
        return rows.half() if self.request.half_softmax else rows

    def finish(self, scan: ScanForDevice, computed: ScanOfBatch) -> LabelledScan:
        """Return the labelled scan; `WeightsError` if a probability is not finite."""
        results = final_results(computed, lambda rounds: self.compute([scan], rounds)[0])
        labels = DeviceLabels(**results)
        checked = scan.checked
        if not labels.is_finite:
            raise self.network.backend.not_finite(checked.source)
        check = replace(checked.check, ego_points=int(labels.ego_points))
        return LabelledScan(
            checked=replace(checked, check=check),
            labels=labels.labels,
            least_confidence=labels.least_confidence,
            pixel_labels=labels.pixel_labels,
            mean_confidence=float(labels.mean_confidence),
            softmax=labels.softmax,
            error=labels.error,
        )


def _mean_confidence(confidence: Tensor, images: RangeImages) -> Tensor:
    """Return the mean confidence (B,) of the occupied pixels of (B, H, W); 1 without any."""
    occupied = images.occupied
    total = confidence.double().where(occupied, 0).flatten(1).sum(dim=1)
    count = occupied.flatten(1).sum(dim=1)
    return (total / count).where(count > 0, 1)
