# SPDX-License-Identifier: MIT
"""A network whose inputs need every step: the sensor of the scans is unlike the trained one."""

from dataclasses import replace

import numpy as np
from error_models import layers
from scans import SMALL

from salsanext_cli import Network
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS
from salsanext_cli.core.uncertainty.error_features import FEATURES

RISING = tuple(np.linspace(0, 1, INTENSITY_LEVELS).tolist())
SQUARES = tuple(np.square(np.linspace(0, 3, INTENSITY_LEVELS)).tolist())


def for_unlike_sensor(network: Network) -> Network:
    """Return a network with an error model, for a tilted sensor of a vehicle.

    Gaps between rows are filled, and intensities are matched.
    """
    trained = replace(SMALL, intensity_quantiles=SQUARES, row_gaps=0.1)
    model = ErrorModel(features=FEATURES, layers=layers(9, 6, 1))
    card = replace(network.card, sensor=trained, error=model)
    sensor = replace(
        SMALL,
        origin=(0.0, 0.0, 0.5),
        up=(0.1, -0.2, 1.0),
        ego_box=(-7.0, -6.0, -3.0, 7.0, 6.0, 1.0),
        intensity_quantiles=RISING,
        row_gaps=0.5,
    )
    return replace(network, backend=replace(network.backend, card=card), sensor=sensor)
