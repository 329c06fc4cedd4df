# SPDX-License-Identifier: MIT
"""Runs over scans: their output folders, their records, their loop."""
