# SPDX-License-Identifier: MIT
"""Which network a stage uses: loaded once per worker, recorded with the results."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from salsanext_cli.errors import NOTICE, WeightsError
from salsanext_cli.inference.network import Network, load_network
from salsanext_cli.network.weights import default_weights
from salsanext_cli.parallel.devices import own_device
from salsanext_cli.sensors import Sensor
from salsanext_cli.storage.identity import fingerprint, identity

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class NetworkSettings:
    """Weights, device and sensor, small enough to be sent to another process.

    Attributes
    ----------
    weights : Path, optional
        A weights file; None for the default weights.
    device : str
        As `load_network` takes it.
    sensor : Sensor, optional
        What the scans come from, if not from the sensor that the weights name.
    precision : str
        As `load_network` takes it.
    sha256 : str, optional
        Of the weights that a run began with; others are refused.
    """

    weights: Path | None = None
    device: str = "auto"
    sensor: Sensor | None = None
    precision: str = "float32"
    sha256: str | None = None

    def load(self) -> Network:
        """Load the network, once per thread unless the file is replaced.

        Threads do not share one: each may have a GPU of its own.

        Raises
        ------
        WeightsError
            If the file cannot be used, or was replaced since the run began.
        """
        path = self.weights or default_weights()
        wanted = self, identity(path)
        if _LOADED.network and self.sha256 and _LOADED.wanted[0] == self:
            return _LOADED.network
        if _LOADED.network is None or _LOADED.wanted != wanted:
            if self.sha256 and self.sha256 != fingerprint(path):
                found = "was replaced since the run began"
                raise WeightsError(path, found, "the same file", "run again with --overwrite")
            device = own_device(self.device, torch.cuda.device_count())
            _LOADED.network = load_network(self.weights, device, self.sensor, self.precision)
            _LOADED.wanted = wanted
        return _LOADED.network

    def resolved(self) -> NetworkSettings:
        """Tell the user what computes, and return the choice for workers: in the same precision.

        What is "auto" here might be another number type on their machines. And the same weights: a
        training that goes on may replace its best ones.
        """
        network = self.load()
        name = self.weights or "default weights"
        log.log(NOTICE, "%s on %s in %s", name, network.device, network.precision)
        sha256 = fingerprint(self.weights or default_weights())
        chosen = replace(self, precision=network.precision, sha256=sha256)
        _LOADED.wanted = chosen, _LOADED.wanted[1]
        return chosen

    def settings(self) -> dict[str, Any]:
        """Return what the results of a stage depend on."""
        network = self.load()
        return {
            "weights": fingerprint(self.weights or default_weights()),
            "label_space": network.card.space.to_dict(),
            "sensor": {"name": network.sensor.name, **network.sensor.view()},
            "precision": network.precision,
        }


class _Loaded(threading.local):
    wanted: tuple[NetworkSettings | None, tuple[object, ...]] = (None, ())
    network: Network | None = None


_LOADED = _Loaded()
