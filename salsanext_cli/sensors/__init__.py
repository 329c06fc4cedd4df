# SPDX-License-Identifier: MIT
"""Geometry of a sensor; no statistics of scans."""
