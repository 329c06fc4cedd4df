# SPDX-License-Identifier: MIT
"""Bytes on disk, and nothing of the method."""
