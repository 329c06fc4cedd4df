# SPDX-License-Identifier: MIT
"""Counts, warnings and summaries of the scans of a run."""
