# SPDX-License-Identifier: MIT
"""Differences of a sensor from that of training, and the reasons to doubt a scan."""
