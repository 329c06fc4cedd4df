# SPDX-License-Identifier: MIT
"""Bytes to records and back; the only code that opens a point file."""
