# SPDX-License-Identifier: MIT
"""Scans of a source: their files, their search, and the selection among them."""
