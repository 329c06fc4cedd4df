# SPDX-License-Identifier: MIT
"""A procedural street and a simulated LiDAR."""
