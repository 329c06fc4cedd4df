# SPDX-License-Identifier: MIT
"""Reasons to doubt a scan, from its points alone."""
