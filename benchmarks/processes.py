# SPDX-License-Identifier: MIT
"""Processes that run a script of this folder; only the standard library is needed."""

import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
"""The checkout, which has the packages `benchmarks` and `salsanext_cli`."""


def script_command(module: str, *words: object) -> list[str]:
    """Return the command that runs a module of this package with some words."""
    return [sys.executable, "-m", module, *map(str, words)]


def script_environment() -> dict[str, str]:
    """Return the environment in which Python finds the packages of the checkout, uninstalled."""
    inherited = os.environ.get("PYTHONPATH")
    path = f"{ROOT}{os.pathsep}{inherited}" if inherited else str(ROOT)
    return {**os.environ, "PYTHONPATH": path}
