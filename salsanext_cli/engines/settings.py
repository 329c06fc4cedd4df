# SPDX-License-Identifier: MIT
"""Settings of a network: weights, device, sensor and precision."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.engines.loading import load_network
from salsanext_cli.engines.network import Network
from salsanext_cli.errors import NOTICE, WeightsError
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.network.card import default_weights, joined
from salsanext_cli.sensors.sensor import NOISE, Sensor

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class NetworkSettings:
    """Settings of a network to load; small enough to be sent to another process."""

    weights: Path | None = None  # A weights file; None for the default weights
    device: str = "auto"  # As `load_network` takes it
    sensor: Sensor | None = None  # Origin of the scans, if not the sensor that the weights name
    precision: str = "float32"  # As `load_network` takes them
    engine: str = "auto"
    # Whether a view and a mounting that differ much from the sensor's are those of the scans; None:
    # if no sensor is named
    fit: bool | None = None
    # {"auto", "match", "raw", "none"}: as `fit_network` takes it; "auto" matches where the
    # weights know their quantiles
    intensity: str = "auto"
    # Whether the batch norm is to be adapted to the scans, as `adaptation.network_of_run` does
    adapt: bool = False
    adapted: Path | None = None  # The weights file that came of it: this one is loaded
    sha256: str | None = None  # Of the weights file that a run began with; others are refused
    classes: LabelSpace | None = None  # As `load_network` takes them

    @property
    def path(self) -> Path:
        """The weights file that was asked for."""
        return self.weights or default_weights()

    @property
    def fits_view(self) -> bool:
        """True if the view is to be fitted to the scans."""
        return self.sensor is None if self.fit is None else self.fit

    def load(self) -> Network:
        """Load the network."""
        file = self.adapted or self.path
        if self.sha256 and self.sha256 != fingerprint(file):
            found = "was replaced since the run began"
            raise WeightsError(file, found, "the same file", "run again with --overwrite")
        wanted = self.adapted or self.weights
        how = (self.device, self.sensor, self.precision, self.engine, self.classes)
        return load_network(wanted, *how)

    def announce(self, network: Network) -> None:
        """Log what computes, and on what the default weights were trained."""
        name = self.weights or f"default weights ({network.card.summary()})"
        how = (network.device, network.engine.library, network.engine.precision)
        adapted = f", adapted: {self.adapted}" if self.adapted else ""
        merged = f", merged into the classes of {network.space.name}" if network.merging else ""
        log.log(NOTICE, "%s on %s by %s in %s%s%s", name, *how, adapted, merged)

    def resolved(self, network: Network) -> NetworkSettings:
        """Log what computes, and return the settings for workers: all the same, same weights.

        What is "auto" here might be something else on their machines, and a training that goes on
        may replace its best weights.
        """
        self.announce(network)
        return replace(
            self,
            device="cpu" if network.device == "cpu" else self.device,
            sensor=network.sensor,
            precision=network.engine.precision,
            engine=network.engine.library,
            sha256=network.engine.sha256,
        )

    def record(self, network: Network) -> dict[str, Any]:
        """Return what the results of a stage depend on, as plain data for its record."""
        engine = network.engine
        known = {"adapted": engine.sha256} if self.adapted else {}
        if network.card.trained_on:
            known["trained_on"] = joined(sorted(network.card.trained_on))
        return known | {
            "weights": fingerprint(self.path) if self.adapted else engine.sha256,
            "label_space": network.space.to_dict(),
            "sensor": recorded_view(network.sensor),
            "precision": engine.precision,
            "engine": engine.library,
        }


def recorded_view(sensor: Sensor) -> dict[str, Any]:
    """Return what labels depend on of a sensor, and its name, as plain data."""
    return {key: value for key, value in sensor.to_dict().items() if key not in NOISE}
