# SPDX-License-Identifier: MIT
"""Fixtures of output folders, whose tests ask nothing of the network."""

from narrow_network import narrow, weights  # noqa: F401
