# SPDX-License-Identifier: MIT
"""Options: their declarations, and how Typer reads them."""
