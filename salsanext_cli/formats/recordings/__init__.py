# SPDX-License-Identifier: MIT
"""Recordings of many scans, read scan by scan: ROS bags and the packets of Ouster sensors."""
