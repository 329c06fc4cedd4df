# SPDX-License-Identifier: MIT
"""Input of a network from range images of a sensor that differs from that of its training."""

from dataclasses import dataclass

from salsanext_cli.geometry.intensity import match_intensity
from salsanext_cli.geometry.normalise import normalise
from salsanext_cli.geometry.row_gaps import with_filled_gaps
from salsanext_cli.records import Float
from salsanext_cli.sensors.sensor import Sensor


@dataclass(frozen=True, slots=True)
class ScanFit:
    """Sensor of the scans at hand, and that of training."""

    sensor: Sensor
    trained: Sensor

    def filled(self, channels: Float) -> Float:
        """Return (5, H, W) channels with gaps between rows as in training, if both are known."""
        return with_filled_gaps(channels, self.sensor, self.trained)

    def input(self, channels: Float) -> Float:
        """Return (5, H, W) channels as the network takes them, (1, 5, H, W) float32.

        Gaps and intensity become those of training where both sensors know theirs.
        """
        own, trained = self.sensor.intensity_quantiles, self.trained.intensity_quantiles
        if own and trained:
            channels = match_intensity(channels, own, trained)
        return normalise(self.filled(channels), self.sensor)[None]
