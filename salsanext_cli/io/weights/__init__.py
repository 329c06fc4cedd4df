# SPDX-License-Identifier: MIT
"""Weights files, and other forms of networks."""
