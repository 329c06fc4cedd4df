# SPDX-License-Identifier: MIT
"""Scans of a batch to labels without leaving the device: projection, network and kNN."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from salsanext_cli.geometry.knn import KnnParameters
from salsanext_cli.geometry.knn_torch import refine_tensors
from salsanext_cli.geometry.projection_parameters import ProjectionParameters
from salsanext_cli.geometry.projection_torch import project_tensors
from salsanext_cli.inference.captured import Captured
from salsanext_cli.inference.network import Network

log = logging.getLogger(__name__)

Points = tuple[Tensor, Tensor]
"""Coordinates (N, 3) and intensity (N,) of a scan, float32."""


@dataclass(frozen=True, slots=True, eq=False)
class Labelled:
    """What is found for a scan, on the device.

    Attributes
    ----------
    labels : (N,) uint8
        Train id of every point, after kNN.
    probabilities : (C, H, W) float32
        Softmax of every pixel.
    pixel_labels : (H, W) uint8
        The most probable class of every pixel.
    pixel_of_point : (N,) int32
        Flat pixel index, -1 without a pixel.
    """

    labels: Tensor
    probabilities: Tensor
    pixel_labels: Tensor
    pixel_of_point: Tensor


class BatchLabeller:
    """Labels several scans together, fewer if memory is short.

    Parameters
    ----------
    network : Network
        Whose device computes everything.
    knn : KnnParameters
        Neighbours of the clean-up.
    size : int
        Scans together; halved when memory runs out.
    """

    def __init__(self, network: Network, knn: KnnParameters, size: int) -> None:
        self.network, self.knn, self.size = network, knn, size
        self.view = ProjectionParameters.of(network.sensor)
        self.logits = Captured(network.engine)
        shape = (5, 1, 1)
        self.means = torch.tensor(network.sensor.means, device=network.device).view(shape)
        self.stds = torch.tensor(network.sensor.stds, device=network.device).view(shape)

    def label(self, scans: Sequence[Points]) -> list[Labelled]:
        """Label scans, whose tensors may be anywhere.

        Raises
        ------
        torch.OutOfMemoryError
            If there is no room for a single one.
        """
        found: list[Labelled] = []
        while len(found) < len(scans):
            try:
                with self.network.computing():
                    found += self._label(scans[len(found) : len(found) + self.size])
            except torch.OutOfMemoryError:
                if self.size == 1:
                    raise
                self.logits.forget()
                self.size //= 2
                log.warning(
                    "memory for %d scans at once is not there, going on with %d",
                    *(2 * self.size, self.size),
                )
        return found

    def _label(self, scans: Sequence[Points]) -> list[Labelled]:
        device = self.network.device
        on_device = [[part.to(device, non_blocking=True) for part in scan] for scan in scans]
        seen = [project_tensors(points, values, self.view) for points, values in on_device]
        images = torch.stack([self._normalised(channels) for channels, *_ in seen])
        if device.type == "cuda":
            # One size of batch is one recording, and one choice of algorithms.
            images = F.pad(images, (*6 * (0,), 0, self.size - len(scans)))
        images = images.contiguous(memory_format=torch.channels_last)
        logits = self.logits(images)[: len(scans)] / self.network.card.temperature
        probabilities = torch.softmax(logits, dim=1)
        pixel_labels = probabilities.argmax(dim=1).to(torch.uint8)
        found = []
        for number, (channels, pixel_of_point, _, point_range) in enumerate(seen):
            of_image = pixel_labels[number]
            view = channels[0], of_image, pixel_of_point, point_range
            labels = refine_tensors(*view, self.knn)
            found.append(Labelled(labels, probabilities[number], of_image, pixel_of_point))
        return found

    def _normalised(self, channels: Tensor) -> Tensor:
        """Return (5, H, W) as `geometry.normalise` does, bit for bit."""
        normal = (channels - self.means) / self.stds
        return torch.where(channels[0] > 0, normal, 0.0)
