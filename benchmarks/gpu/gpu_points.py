# SPDX-License-Identifier: MIT
"""Speed of the way of points on a device: projection, kNN, labels and errors, by batch."""

import logging
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import torch

import salsanext_cli as sn
from benchmarks.gpu.gpu_measures import NETWORK, Figures
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.labellers import labeller_for
from salsanext_cli.core.labelling import EstimatedScan, LabelledScan, LabelRequest
from salsanext_cli.core.on_device.estimator import DeviceEstimator, ScanToEstimate
from salsanext_cli.core.on_device.knn import knn_refine
from salsanext_cli.core.on_device.labeller import DeviceLabeller
from salsanext_cli.core.on_device.network_input import network_inputs
from salsanext_cli.core.on_device.projection import project
from salsanext_cli.core.on_device.scan_batch import ScanBatch
from salsanext_cli.core.on_device.scan_for_device import ScanForDevice
from salsanext_cli.core.records import Scan
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.uncertainty.error_features import knows_error
from salsanext_cli.core.uncertainty.estimate_request import EstimateRequest
from salsanext_cli.core.uncertainty.method import ALEATORIC_METHODS, UncertaintyMethod
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.weights.loading import load_network

BATCHES = {"cpu": (1, 2), "cuda": (1, 16)}
REPETITIONS = 20
REPETITIONS_OF_PASSES = 3  # Of the passes of a scan, which take long
ENGINE = "torch"


def measure_points(
    figures: Figures, weights: Path, sensor: Sensor, path: Path, passes: int
) -> None:
    """Measure each step of batches of one scan, its check, its labels and its uncertainty.

    Parameters
    ----------
    figures : Figures
        Record of the figures.
    weights : Path
        Weights file.
    sensor : Sensor
        Sensor of the scan.
    path : Path
        File of the scan.
    passes : int
        Monte-Carlo passes of the uncertainty.
    """
    logging.getLogger("salsanext_cli").addHandler(logging.NullHandler())  # Of equal warnings
    size = f"{sensor.height}×{sensor.width}"
    pixels = sensor.height * sensor.width
    if not figures.has_time_for_calls(f"{size} on the device", NETWORK, 3 * pixels):
        return
    network = load_network(weights, figures.device, sensor, "auto", ENGINE)
    scan = read_scan(path, sensor)
    on_host: dict[str, Callable[[], object]] = {
        "check of a scan": partial(labeller_for(network, LabelRequest()).prepare, scan),
        "sn.label of a scan in memory": partial(sn.label, scan.points, scan.intensity, network),
    }
    for step, call in on_host.items():
        name = f"{size} {step}"
        if figures.has_time_for_calls(name, step, pixels, passes=2.0):
            figures.add(name, 1e3 * figures.seconds_of(step, pixels, call, REPETITIONS), "ms")
    measure_uncertainty(figures, network, scan, passes)
    for batch in BATCHES[torch.device(figures.device).type]:
        name = f"{size} on the device, batch {batch}"
        if not figures.has_time_for_calls(name, NETWORK, batch * pixels):
            return
        with torch.inference_mode():
            for step, call in steps_of_batch(network, scan, batch).items():
                name = f"{size} on the device, batch {batch}: {step}"
                if not figures.has_time_for_calls(name, step, batch * pixels, passes=2.0):
                    continue
                with figures.peak_memory() as peak:
                    seconds = figures.seconds_of(step, batch * pixels, call, REPETITIONS)
                    figures.add(name, 1e3 * seconds / batch, f"ms a scan{peak()}")


def measure_uncertainty(figures: Figures, network: sn.Network, scan: Scan, passes: int) -> None:
    """Measure a scan on the device to its uncertainty, by the method of the sensor's noise."""
    size = f"{network.sensor.height}×{network.sensor.width}"
    pixels = network.sensor.height * network.sensor.width
    for aleatoric in ALEATORIC_METHODS:
        step = f"points to uncertainty, {passes} passes, aleatoric {aleatoric}"
        name = f"{size} on the device: {step}"
        if not figures.has_time_for_calls(name, step, pixels, passes=2.0 * passes):
            continue
        method = UncertaintyMethod(samples=passes, aleatoric=aleatoric)
        estimator = DeviceEstimator(network=network, request=EstimateRequest(method=method))
        prepared = [estimator.prepare(scan, 0)]
        with figures.peak_memory() as peak:
            call = partial(estimated, estimator, prepared)
            seconds = figures.seconds_of(step, pixels, call, REPETITIONS_OF_PASSES)
            figures.add(name, 1e3 * seconds, f"ms{peak()}")


def steps_of_batch(network: sn.Network, scan: Scan, batch: int) -> dict[str, Callable[[], object]]:
    """Return the steps of a batch of copies of one scan, by name, each with its input."""
    labels_only = DeviceLabeller(network=network, request=LabelRequest())
    prepared = [labels_only.prepare(scan)] * batch
    points = [copy.points for copy in prepared]
    sensors = [copy.checked.sensor for copy in prepared]
    scans = ScanBatch.on_device(points, sensors, network.device)
    images = project(scans)
    classes = network.space.class_count
    labels = torch.randint(classes, images.occupied.shape, device=scans.points.device)
    trained = network.card.sensor
    steps: dict[str, Callable[[], object]] = {
        "points to the device": partial(ScanBatch.on_device, points, sensors, network.device),
        "projection": partial(project, scans),
        "input of the network": partial(network_inputs, images.channels, sensors, trained),
        "kNN of random labels": partial(knn_refine, images, labels.byte(), KnnParameters()),
        "points to labels": partial(labelled, labels_only, prepared),
    }
    if knows_error(network):
        with_error = DeviceLabeller(network=network, request=LabelRequest(error=True))
        steps["points to labels and errors"] = partial(labelled, with_error, prepared)
    return steps


def labelled(labeller: DeviceLabeller, scans: Sequence[ScanForDevice]) -> list[LabelledScan]:
    """Return labelled scans, whose results have come back."""
    computed = labeller.compute(scans)
    return [labeller.finish(*pair) for pair in zip(scans, computed, strict=True)]


def estimated(estimator: DeviceEstimator, scans: Sequence[ScanToEstimate]) -> list[EstimatedScan]:
    """Return scans with their uncertainty, whose results have come back."""
    computed = estimator.compute(scans)
    return [estimator.finish(*pair) for pair in zip(scans, computed, strict=True)]
