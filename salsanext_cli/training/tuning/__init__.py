# SPDX-License-Identifier: MIT
"""Fits of trained weights to other scans: temperature, dropout rate, batch norm."""
