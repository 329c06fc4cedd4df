# SPDX-License-Identifier: MIT
"""Folder to folder: one file and one public function per stage."""
