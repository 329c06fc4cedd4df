# SPDX-License-Identifier: MIT
"""Validation of a network in training, by the CPU kernels or on its GPU."""
