# SPDX-License-Identifier: MIT
"""Ranges for int8 in the weights of a finished training."""

from dataclasses import replace
from pathlib import Path

from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.records import Float
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.weights.loading import network_of_module
from salsanext_cli.io.weights.weights import encode_weights, read_weights
from salsanext_cli.runs.fit.scan_reading import read_prepared
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.selection import evenly_spaced
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.run_folder import BEST, LAST
from salsanext_cli.training.tuning.int8 import int8_inputs, int8_layers

INT8_SCANS = 8  # Training scans that the ranges of values in int8 are fitted to


def add_int8_ranges(run: Path, source: Source, device: str) -> None:
    """Add ranges for int8 to the weights of a finished training, unless they are there."""
    # Both weights are given the same images if they were trained with the same sensor.
    images_for: dict[Sensor, list[Float]] = {}
    for path in filter(Path.exists, (run / BEST, run / LAST)):
        module, card = read_weights(path)
        if card.int8 or not int8_layers(module):
            continue
        network = network_of_module(module.to(device), card, device)
        if card.sensor not in images_for:
            images_for[card.sensor] = _images(source, network)
        card = replace(card, int8=int8_inputs(module, images_for[card.sensor]))
        OwnedFolder(run).write(path, encode_weights(module, card), durable=True)


def _images(source: Source, network: Network) -> list[Float]:
    """Return what a network is given of some scans: images (1, 5, H, W) float32."""
    images = []
    for file in evenly_spaced(source.files, INT8_SCANS):
        network_of_scan = network.for_sensor(source.sensor_of(file))
        images.append(read_prepared(file, network_of_scan).scan.input)
    return images
