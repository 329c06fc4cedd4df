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


def modules_with_functions() -> list[Path]:
    """Return the modules that define a function or a method, relative to the package."""
    modules = []
    for path in sorted(PACKAGE.rglob("*.py")):
        nodes = ast.walk(ast.parse(path.read_text("utf-8")))
        is_package = path.name.startswith("__")
        if not is_package and any(isinstance(node, ast.FunctionDef) for node in nodes):
            modules.append(path.relative_to(PACKAGE))
    return modules


def mirror_of(module: Path) -> Path:
    """Return the test file that mirrors a module; both are relative to their folders."""
    return module.with_name(f"test_{module.name}")


@cache
def without_mirror() -> list[Path]:
    """Return the modules that have no test file of their name."""
    return [
        module for module in modules_with_functions() if not (TESTS / mirror_of(module)).exists()
    ]


def main() -> None:
    """Print the modules, and how many of all they are."""
    missing = without_mirror()
    for module in missing:
        print(module.as_posix())
    print(f"{len(missing)} of {len(modules_with_functions())} modules")


if __name__ == "__main__":
    main()
