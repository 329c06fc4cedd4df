# SPDX-License-Identifier: MIT
"""Runs before their first scan: what they decide, and what they would do."""
