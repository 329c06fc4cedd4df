# SPDX-License-Identifier: MIT
"""Sensor on its vehicle, as it records one sequence."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli.synthesis.mesh import Array, Rng
from salsanext_cli.synthesis.sensor.beams import Beams
from salsanext_cli.synthesis.sensor.hdl64 import hdl64
from salsanext_cli.synthesis.sensor.lidar import HDL64, Firings, Response
from salsanext_cli.synthesis.sensor.random_sensor import (
    random_beams,
    random_mount,
    random_response,
    random_shadow,
)
from salsanext_cli.synthesis.sensor.shadow import hidden_by_vehicle

HDL64_MOUNT_M = 1.73


@dataclass(frozen=True, slots=True)
class Rig:
    """A sensor and its mounting."""

    beams: Beams  # Its lasers
    response: Response  # What it makes of the pulses that return
    seen: npt.NDArray[np.bool_]  # (L * columns,) bool: rays that the vehicle does not block
    mount: float  # Height above the road, metres
    tilt: Array  # (2,): pitch and roll of the mounting, radians

    def rays(self) -> tuple[Array, Array, Array]:
        """Return origins, directions and times of the rays that leave the vehicle."""
        origins, directions, times = self.beams.rays()
        return origins[self.seen], directions[self.seen], times[self.seen]

    def firings(self) -> Firings:
        """Return the properties of the laser that fires each ray."""
        beams = self.beams
        of_laser = (beams.gain, beams.offset, beams.power)
        return Firings(*(np.repeat(values, beams.columns)[self.seen] for values in of_laser))


RigMaker = Callable[[Rng], Rig]
"""Draws a sensor and its mounting."""


def hdl64_rig(rng: Rng) -> Rig:
    """Draw an HDL-64E and its mounting."""
    beams = hdl64(rng)
    tilt = rng.normal(0, np.radians(0.35), 2)
    return Rig(beams, HDL64, ~hidden_by_vehicle(beams, rng), HDL64_MOUNT_M, tilt)


def random_rig(rng: Rng) -> Rig:
    """Draw a sensor unlike others, and its mounting."""
    beams, response = random_beams(rng), random_response(rng)
    seen = ~random_shadow(beams, rng)
    mount, tilt = random_mount(rng)
    return Rig(beams, response, seen, mount, tilt)


RIGS: dict[str, RigMaker] = {"hdl64": hdl64_rig, "random": random_rig}
"""Makers of the sensor of a sequence by the name that `--sensor` takes."""
