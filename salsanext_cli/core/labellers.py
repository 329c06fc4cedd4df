# SPDX-License-Identifier: MIT
"""Labels of scans: by the CPU kernels, or on the GPU that computes the network.

This is the only place that chooses between both. A labeller works in three steps, which the job of
`predict` takes on different threads; `label_scan` takes them in turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, cast

import numpy as np

from salsanext_cli.core.engines.backend import DeviceBackend, PixelPrediction
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.geometry.projection import points_from_pixels
from salsanext_cli.core.labelling import (
    LabelledScan,
    LabelRequest,
    PreparedScan,
    predict_pixels,
    prepare_for,
    project_scan,
    refine_labels,
)
from salsanext_cli.core.records import Float, Origin, Scan
from salsanext_cli.core.uncertainty.error_features import error_probability


class Labeller(Protocol):
    """Way of scans to their labels."""

    @property
    def network(self) -> Network:
        """Network for the sensors of the scans."""

    def prepare(self, scan: Scan, origin: Origin | None = None, source: object = "scan") -> Any:
        """Check a scan and make it ready for the device, on any thread.

        Parameters
        ----------
        scan : Scan
            N points, in the frame of their file.
        origin : tuple of float, optional
            Position of the sensor of a registered scan, in metres; by default found from its
            points.
        source : object
            Name of the scan in errors.

        Returns
        -------
        object
            Scan for `compute`.

        Raises
        ------
        FormatError
            If the points are not those of a scan in metres around a sensor.
        """

    def compute(self, scans: Sequence[Any]) -> Sequence[Any]:
        """Compute what `finish` needs of scans that `prepare` made ready, together.

        A GPU may still compute when it returns; `finish` waits for it.
        """

    def finish(self, scan: Any, computed: Any) -> LabelledScan:
        """Return the labelled scan, on any thread; `WeightsError` if a result is not finite."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KernelLabeller:
    """Labels scans by the CPU kernels, and their pixels by any backend.

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
    ) -> PreparedScan:
        """Check and project a scan, and make the input of the network."""
        network = self.network
        projected = project_scan(scan, network.sensor, network.card.sensor, origin, source)
        return prepare_for(network, projected)

    def compute(self, scans: Sequence[PreparedScan]) -> list[PixelPrediction]:
        """Predict the pixels of scans together."""
        softmax = self.request.softmax or self.request.error
        return predict_pixels(self.network, scans, softmax=softmax)

    def finish(self, scan: PreparedScan, computed: PixelPrediction) -> LabelledScan:
        """Refine the labels of the pixels on the points."""
        labelled = refine_labels(scan, computed, self.request.knn)
        image = scan.projected.image
        if self.request.softmax:
            unlabelled = np.eye(1, self.network.space.class_count)
            pixel_softmax = cast(Float, computed.softmax)
            softmax = points_from_pixels(pixel_softmax, image.pixel_of_point, unlabelled)
            number_type = np.float16 if self.request.half_softmax else np.float32
            labelled = replace(labelled, softmax=softmax.astype(number_type, copy=False))
        if self.request.error:
            pixel_softmax = cast(Float, computed.softmax)
            error = error_probability(scan.network, image, pixel_softmax, labelled.labels)
            labelled = replace(labelled, error=error)
        return labelled


def labeller_for(network: Network, request: LabelRequest) -> Labeller:
    """Return what labels scans with a network: the GPU that computes it, else the kernels."""
    if not computes_on_gpu(network):
        return KernelLabeller(network=network, request=request)
    # Only here, because other engines need no torch.
    from salsanext_cli.core.on_device.labeller import DeviceLabeller

    return DeviceLabeller(network=network, request=request)


def computes_on_gpu(network: Network) -> bool:
    """Return whether a network computes from tensors on a GPU, which then labels the points too."""
    return isinstance(network.backend, DeviceBackend) and network.device != "cpu"


def label_scan(
    scan: Scan,
    network: Network,
    request: LabelRequest = LabelRequest(),
    *,
    origin: Origin | None = None,
    source: object = "scan",
) -> LabelledScan:
    """Label the points of a scan with a network that is fitted to its sensor.

    Parameters
    ----------
    scan : Scan
        N points, in the frame of their file.
    network : Network
        Network for the sensors of such scans.
    request : LabelRequest
        Neighbourhood of the refinement, and further results.
    origin : tuple of float, optional
        Position of the sensor of a registered scan, in metres; by default found from its points.
    source : object
        Name of the scan in errors.

    Returns
    -------
    LabelledScan

    Raises
    ------
    FormatError
        If the points are not those of a scan in metres around a sensor.
    WeightsError
        If a probability is not finite.
    """
    labeller = labeller_for(network, request)
    prepared = labeller.prepare(scan, origin, source)
    (computed,) = labeller.compute([prepared])
    return labeller.finish(prepared, computed)
