# SPDX-License-Identifier: MIT
"""The output folder: layout, atomic writes, locks, and what a run recorded."""
