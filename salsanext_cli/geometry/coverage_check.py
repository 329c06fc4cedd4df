# SPDX-License-Identifier: MIT
"""Notice that scans come from another sensor than the one that was named."""

from __future__ import annotations

import logging

from salsanext_cli.geometry.coverage import FieldOfViewCoverage
from salsanext_cli.sensors import Sensor

TOO_MANY = 0.2
"""Share of points out of view that a matching sensor stays far below: it sees 93 % or more."""
EARLY = 10
"""Scans after which to look: nobody should have to wait for the last of thousands."""

log = logging.getLogger(__name__)


class CoverageCheck:
    """Adds up what the sensor does not see of the scans, and says so once if it is much."""

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor
        self.seen = FieldOfViewCoverage()
        self.scans = 0
        self.warned = False

    def add(self, of_scan: FieldOfViewCoverage) -> None:
        """Take note of a scan."""
        self.seen += of_scan
        self.scans += 1
        if self.scans == EARLY:
            self.finish()

    def finish(self) -> None:
        """Warn, unless that was done or there is nothing to warn of."""
        if self.warned or self.seen.share <= TOO_MANY:
            return
        self.warned = True
        sensor = self.sensor
        log.warning(
            "%.0f %% of the points of %d scans lie outside the view of %s, %+g° to %+g°: "
            "give their sensor with --sensor; `salsanext inspect SCANS --fit FILE.toml` finds it",
            *(100 * self.seen.share, self.scans, sensor.name, sensor.fov_up, sensor.fov_down),
        )
