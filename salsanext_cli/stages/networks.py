# SPDX-License-Identifier: MIT
"""Which network a stage uses: loaded once per process, recorded with the results."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from salsanext_cli.formats.identity import fingerprint, identity
from salsanext_cli.network.inference import Network, load_network
from salsanext_cli.network.weights import default_weights
from salsanext_cli.sensors import Sensor

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class NetworkChoice:
    """Weights, device and sensor, small enough to be sent to another process.

    Attributes
    ----------
    weights : Path, optional
        A weights file; None for the default weights.
    device : str
        As `load_network` takes it.
    sensor : Sensor, optional
        What the scans come from, if not from the sensor that the weights name.
    """

    weights: Path | None = None
    device: str = "auto"
    sensor: Sensor | None = None

    def load(self) -> Network:
        """Load the network, once per process unless the file is replaced."""
        return _load(self, identity(self.weights or default_weights()))

    def settings(self) -> dict[str, Any]:
        """Return what the results of a stage depend on."""
        network = self.load()
        return {
            "weights": fingerprint(self.weights or default_weights()),
            "label_space": network.card.space.to_dict(),
            "sensor": {"name": network.sensor.name, **network.sensor.view()},
        }


@lru_cache(maxsize=1)
def _load(choice: NetworkChoice, _: tuple[object, ...]) -> Network:
    network = load_network(choice.weights, choice.device, choice.sensor)
    log.info("%s on %s", choice.weights or "default weights", network.device)
    return network
