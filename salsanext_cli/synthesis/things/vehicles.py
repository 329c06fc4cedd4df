# SPDX-License-Identifier: MIT
"""Choice of a vehicle of any kind."""

import numpy as np

from salsanext_cli.synthesis.mesh import Mesh, Rng
from salsanext_cli.synthesis.presets import TRAFFIC
from salsanext_cli.synthesis.things.cars import car
from salsanext_cli.synthesis.things.others import bus, other_vehicle
from salsanext_cli.synthesis.things.trucks import truck

MAKERS = {"car": car, "truck": truck, "bus": bus, "other": other_vehicle}


def vehicle(rng: Rng) -> Mesh:
    """Return a car, truck, bus or other vehicle, as usual as the presets say."""
    shares = np.array(list(TRAFFIC.values()))
    return MAKERS[list(TRAFFIC)[rng.choice(len(shares), p=shares / shares.sum())]](rng)


def length_of(mesh: Mesh) -> float:
    """Return the length of a vehicle in its own frame, metres."""
    return float(np.ptp(mesh.vertices[:, 0]))
