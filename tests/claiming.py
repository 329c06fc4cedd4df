# SPDX-License-Identifier: MIT
"""Runs of stages that begin and end without doing anything."""

from typing import Any

from salsanext_cli.storage.output_run import claimed


def claim(*arguments: Any, **options: Any) -> None:
    """Claim an output folder, as a run does that finds nothing to do."""
    with claimed(*arguments, **options):
        pass
