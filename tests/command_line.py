# SPDX-License-Identifier: MIT
"""Read what commands print, and run Python as a user does."""

import json
import os
import subprocess
import sys
from typing import Any

import pytest
from typer.testing import Result


def only_json(result: Result) -> dict[str, Any]:
    """Return the one JSON object on stdout."""
    assert result.stdout.count("\n") == 1, result.stdout
    found = json.loads(result.stdout, parse_constant=pytest.fail)
    assert isinstance(found, dict)
    return found


def python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, **environment},
    )
