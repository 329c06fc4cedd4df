# SPDX-License-Identifier: MIT
"""Checks of scans before a network sees them."""
