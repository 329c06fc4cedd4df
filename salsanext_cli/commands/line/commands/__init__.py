# SPDX-License-Identifier: MIT
"""Commands: one file per command, which parses, calls a stage and reports."""
