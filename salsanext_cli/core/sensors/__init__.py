# SPDX-License-Identifier: MIT
"""Sensors: presets, TOML files and limits."""
