# SPDX-License-Identifier: MIT
"""Fits to labelled scans: temperature, model of errors, threshold of risk, dropout rate."""
