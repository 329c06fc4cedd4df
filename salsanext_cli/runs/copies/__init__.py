# SPDX-License-Identifier: MIT
"""Copies of scans and bags in a folder of the user."""
