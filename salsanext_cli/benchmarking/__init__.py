# SPDX-License-Identifier: MIT
"""Measurements of `salsanext benchmark`: the toolkit beside the plain baseline."""
