# SPDX-License-Identifier: MIT
"""Uncertainty of scans on a device: points are copied there once, and results of points back."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.core.engines.backend import DeviceBackend, device_backend
from salsanext_cli.core.engines.device_copies import pinned_array
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.labelling import EstimatedScan, checked_scan
from salsanext_cli.core.on_device.batch_results import BatchResults, ScanOfBatch, final_results
from salsanext_cli.core.on_device.error_probability import error_probability
from salsanext_cli.core.on_device.host_points import HostPoints
from salsanext_cli.core.on_device.knn import knn_refine
from salsanext_cli.core.on_device.network_input import network_inputs
from salsanext_cli.core.on_device.noise import input_variance, noisy_copies
from salsanext_cli.core.on_device.projection import ego_counts, points_from_pixels, project
from salsanext_cli.core.on_device.regions import ROUNDS
from salsanext_cli.core.on_device.scan_batch import ScanBatch
from salsanext_cli.core.on_device.scan_for_device import ScanForDevice
from salsanext_cli.core.records import Origin, Scan
from salsanext_cli.core.uncertainty.adf import Gaussian
from salsanext_cli.core.uncertainty.aleatoric import COPIES, moments, noise_draws
from salsanext_cli.core.uncertainty.estimate_request import EstimateRequest
from salsanext_cli.core.uncertainty.monte_carlo import pass_seed


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScanToEstimate(ScanForDevice):
    """Scan that is ready for a device, and random numbers of its own.

    Attributes
    ----------
    seed : int
        Seed of the masks of its passes.
    draws : (K, 2, H, W) float32, optional
        Noise of its copies, in memory that the device reads directly; None without copies.
    """

    seed: int
    draws: Tensor | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DeviceEstimator:
    """Estimates the uncertainty of scans on the device of a network in torch; an `Estimator`.

    Masks and noise have the values that they have on a CPU.

    Attributes
    ----------
    network : Network
        Network for the sensors of the scans.
    request : EstimateRequest
        Results of each scan.
    """

    network: Network
    request: EstimateRequest

    def prepare(
        self, scan: Scan, seed: int, origin: Origin | None = None, source: object = "scan"
    ) -> ScanToEstimate:
        """Find the sensor of a scan, check its points, and copy them and its noise."""
        network = self.network
        checked = checked_scan(scan, network.sensor, network.card.sensor, origin, source)
        draws = None
        if self.request.method.aleatoric == "copies":
            size = (network.sensor.height, network.sensor.width)
            noise = np.stack([*islice(noise_draws(size, seed), COPIES)])
            draws = pinned_array(noise, network.device)
        return ScanToEstimate(
            checked=checked,
            points=HostPoints.from_scan(scan, network.device),
            seed=seed,
            draws=draws,
        )

    @torch.inference_mode()
    def compute(self, scans: Sequence[ScanToEstimate], rounds: int = ROUNDS) -> list[ScanOfBatch]:
        """Hand scans to the device, and do not wait for their uncertainty.

        They are projected together, and each has its own passes. For errors, the regions of pixels
        are joined in a number of rounds.
        """
        network = self.network
        sensors = [scan.checked.sensor for scan in scans]
        points = [scan.points for scan in scans]
        batch = ScanBatch.on_device(points, sensors, network.device)
        images = project(batch)
        inputs = network_inputs(images.channels, sensors, network.card.sensor)
        pixel_values = [
            self._estimated(scan, channels, image)
            for scan, channels, image in zip(scans, images.channels, inputs, strict=True)
        ]
        mean = torch.stack([values["mean"] for values in pixel_values])
        kinds = self.request.method.kinds
        layers = [torch.stack([values[kind] for values in pixel_values]) for kind in kinds]
        rows = points_from_pixels(torch.stack(layers, dim=1), images, torch.nan)
        point_values = dict(zip(kinds, rows.unbind(dim=1), strict=True))
        scan_values = {
            "is_finite": mean.isfinite().flatten(1).all(dim=1),
            "ego_points": ego_counts(batch, images),
        }
        if self.request.labels:
            labels = knn_refine(images, mean.argmax(dim=1).to(torch.uint8), self.request.knn)
            point_values["labels"] = labels
            if self.request.error:
                softmax = self._backend.softmax(inputs, network.card.temperature)
                errors = error_probability(images, softmax, labels, network.card, rounds)
                point_values["error"] = errors.probability
                scan_values["is_final"] = errors.is_final
                scan_values["is_finite"] &= softmax.isfinite().flatten(1).all(dim=1)
        results = BatchResults.of(batch.counts, point_values, scan_values)
        return [ScanOfBatch(batch=results, number=number) for number in range(len(scans))]

    @property
    def _backend(self) -> DeviceBackend:
        return device_backend(self.network.backend)

    def _estimated(
        self, scan: ScanToEstimate, channels: Tensor, image: Tensor
    ) -> dict[str, Tensor]:
        """Return the mean softmax of a scan and each kind of uncertainty of its pixels.

        Parameters
        ----------
        scan : ScanToEstimate
            The scan.
        channels : (5, H, W) float32
            Its range image.
        image : (5, H, W) float32
            Input of the network.

        Returns
        -------
        dict of Tensor
            "mean" (C, H, W) and kinds (H, W), float32.
        """
        method = self.request.method
        seeds = [pass_seed(scan.seed, number) for number in range(method.samples)]
        values = self._backend.device_sample(image[None], seeds, self.network.merging)
        if method.is_noisy:
            values["aleatoric"] = self._noise_variance(scan, channels, image).mean(dim=0)
            values["total"] = values["epistemic"] + values["aleatoric"]
        return values

    def _noise_variance(self, scan: ScanToEstimate, channels: Tensor, image: Tensor) -> Tensor:
        """Return the variance (C, H, W) of the softmax by the noise; arguments of `_estimated`."""
        sensor = scan.checked.sensor
        trained = self.network.card.sensor
        if scan.draws is None:
            variance = input_variance(channels, sensor, trained)
            mean, spread = self._backend.device_run(
                "moments", moments, image[None], variance, exact=True
            )
            return Gaussian(mean, spread).softmax(dim=1).variance[0]
        draws = scan.draws.to(channels.device, non_blocking=True)
        copies = noisy_copies(channels, sensor, draws)
        inputs = network_inputs(copies, [sensor] * len(copies), trained)
        return self._backend.device_spread(inputs, self.network.merging)

    def finish(self, scan: ScanToEstimate, computed: ScanOfBatch) -> EstimatedScan:
        """Return the uncertainty of a scan; `WeightsError` if a probability is not finite."""
        results = final_results(computed, lambda rounds: self.compute([scan], rounds)[0])
        checked = scan.checked
        if not results["is_finite"]:
            raise self.network.backend.not_finite(checked.source)
        check = replace(checked.check, ego_points=int(results["ego_points"]))
        return EstimatedScan(
            checked=replace(checked, check=check),
            uncertainty={kind: results[kind] for kind in self.request.method.kinds},
            labels=results.get("labels"),
            error=results.get("error"),
        )
