# SPDX-License-Identifier: MIT
"""Folder to folder: one file per command."""
