# SPDX-License-Identifier: MIT
"""The syntax trees of all modules of the package, for tests that read its code."""

import ast
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import salsanext_cli

NAME = "salsanext_cli"
PACKAGE = Path(salsanext_cli.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))
HOME_OF: dict[str, str] = salsanext_cli._HOME_OF
"""Dotted module of each public name of the package."""
MODULE_OF = {
    ".".join(module.relative_to(PACKAGE).with_suffix("").parts).removesuffix(
        ".__init__"
    ): module.relative_to(PACKAGE).as_posix()
    for module in MODULES
}
"""Path in the package by dotted name."""


@cache
def tree_of(module: Path) -> ast.Module:
    """Return the syntax tree of a file, which is parsed once per test process."""
    return ast.parse(module.read_text("utf-8"))


@cache
def nodes_of(tree: ast.AST) -> tuple[ast.AST, ...]:
    """Return all nodes of a syntax tree, which is walked once per test process."""
    return tuple(ast.walk(tree))


@cache
def imports_of(path: Path) -> frozenset[str]:
    """Return the modules of the package that a file imports or names, such as core/texts.py.

    A public name stands for its module, such as `label` for api.py.
    """
    nodes = nodes_of(tree_of(path))
    public = {alias.asname or alias.name for alias in _imported(nodes) if alias.name == NAME}
    dotted: set[str] = set()
    for node in nodes:
        match node:
            case ast.Import(names=aliases):
                dotted.update(alias.name.removeprefix(f"{NAME}.") for alias in aliases)
            case ast.ImportFrom(module=str(module), names=aliases) if module.startswith(NAME):
                parent = module.removeprefix(NAME).removeprefix(".")
                dotted.add(parent)
                dotted.update(f"{parent}.{alias.name}".removeprefix(".") for alias in aliases)
            case ast.Attribute(value=ast.Name(id=name), attr=attribute) if name in public:
                dotted.add(attribute)
            case ast.Constant(value=str(text)):
                dotted.update(re.findall(rf"{NAME}\.([\w.]*\w)", text))
    homes = {HOME_OF[name] for name in dotted if name in HOME_OF}
    return frozenset(MODULE_OF[name] for name in dotted | homes if name in MODULE_OF)


def _imported(nodes: Iterable[ast.AST]) -> list[ast.alias]:
    imports = [node for node in nodes if isinstance(node, ast.Import)]
    return [alias for node in imports for alias in node.names]


def name_of(module: Path) -> str:
    """Return the path of a module in the package, such as core/texts.py."""
    return module.relative_to(PACKAGE).as_posix()
