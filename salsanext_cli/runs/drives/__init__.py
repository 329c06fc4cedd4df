# SPDX-License-Identifier: MIT
"""Drives: the poses of the scans of a sequence."""
