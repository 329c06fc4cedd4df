# SPDX-License-Identifier: MIT
"""The syntax trees of all modules of the package, for tests that read its code."""

import ast
from functools import cache
from pathlib import Path

import salsanext_cli

PACKAGE = Path(salsanext_cli.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))


@cache
def tree_of(module: Path) -> ast.Module:
    """Return the syntax tree of a module, which is parsed once per test process."""
    return ast.parse(module.read_text("utf-8"))


def name_of(module: Path) -> str:
    """Return the path of a module in the package, such as core/texts.py."""
    return module.relative_to(PACKAGE).as_posix()
