# SPDX-License-Identifier: MIT
"""A class and an honest uncertainty for every point of a LiDAR scan."""

__version__ = "0.1.0"
