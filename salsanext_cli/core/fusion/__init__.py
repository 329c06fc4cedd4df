# SPDX-License-Identifier: MIT
"""Fusion of the scans of a drive: checks of poses, and votes for the labels of common locations."""
