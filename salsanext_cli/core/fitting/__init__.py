# SPDX-License-Identifier: MIT
"""Fits of a sensor to its scans."""
