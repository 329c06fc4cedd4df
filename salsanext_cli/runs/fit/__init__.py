# SPDX-License-Identifier: MIT
"""Fit of a network to the scans of a run, and the steps of each scan."""
