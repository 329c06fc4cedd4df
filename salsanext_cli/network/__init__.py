# SPDX-License-Identifier: MIT
"""Pixels to probabilities."""
