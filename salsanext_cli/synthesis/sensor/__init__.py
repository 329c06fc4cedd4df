# SPDX-License-Identifier: MIT
"""Simulated LiDAR."""
