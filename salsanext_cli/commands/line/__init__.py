# SPDX-License-Identifier: MIT
"""Command line: options, commands, and what they print."""
