# SPDX-License-Identifier: MIT
"""List the modules of the package that have no test file of their name.

``core/geometry/knn.py`` is tested by ``tests/core/geometry/test_knn.py``. Modules that only
declare, without a function, need none.

Run: python tools/mirrored_tests.py
"""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "salsanext_cli"
TESTS = ROOT / "tests"


def modules() -> list[Path]:
    """Return the modules of the package, relative to it."""
    paths = [path for path in PACKAGE.rglob("*.py") if not path.name.startswith("__")]
    return sorted(path.relative_to(PACKAGE) for path in paths)


def has_functions(module: Path) -> bool:
    """Return whether a module defines a function or a method."""
    nodes = ast.walk(ast.parse((PACKAGE / module).read_text("utf-8")))
    return any(isinstance(node, ast.FunctionDef) for node in nodes)


def mirror_of(module: Path) -> Path:
    """Return the test file that mirrors a module; both are relative to their folders."""
    return module.with_name(f"test_{module.name}")


@cache
def without_mirror() -> list[Path]:
    """Return the modules that have no test file of their name."""
    lacking = [module for module in modules() if not (TESTS / mirror_of(module)).exists()]
    return [module for module in lacking if has_functions(module)]


def main() -> None:
    """Print the modules, and how many of all they are."""
    missing = without_mirror()
    for module in missing:
        print(module.as_posix())
    print(f"{len(missing)} of {sum(map(has_functions, modules()))} modules")


if __name__ == "__main__":
    main()
