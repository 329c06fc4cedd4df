# SPDX-License-Identifier: MIT
"""A sensor that is not a preset."""

from salsanext_cli.core.sensors.sensor import Sensor

VALID = Sensor("valid", fov_up=3, fov_down=-25, height=64, width=2048)
