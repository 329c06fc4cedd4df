# SPDX-License-Identifier: MIT
"""Single files: whole or not at all, locked, JSON, zip."""
