# SPDX-License-Identifier: MIT
"""The page on development lists what goes with a part of the package."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest
from package_trees import MODULES, PACKAGE, imports_of, name_of, nodes_of, tree_of

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/project/development.md").read_text("utf-8")
SECTION = PAGE.partition("## Remove a part")[2].partition("\n## ")[0]
OUTSIDE = ("tests", "benchmarks", "examples", "docs")  # Folders that use the package
NAMES_FUSE = re.compile(
    "^fuse$|--fuse|salsanext fuse|`fuse`|FUSED|FuseSettings|FusionReach|fused_of|read_fused"
    "|DISAGREEMENT|^disagreement$|^label_drive$"
)
OTHER_MEANINGS = {
    "core/network/salsanext.py",  # Unit that joins three branches of the network
    "training/recipe.py",  # A removed key
}


def rows(columns: int) -> list[list[str]]:
    """Return the cells of the rows of the section's table with a number of columns."""
    lines = [line.strip("|").split("|") for line in SECTION.splitlines() if line.startswith("| ")]
    tables = [[cell.strip() for cell in line] for line in lines if len(line) == columns]
    return tables[1:]


def paths_in(cell: str) -> set[str]:
    return {name for name in re.findall("`([^`]+)`", cell) if "/" in name or name.endswith(".py")}


def belongs(name: str, paths: set[str]) -> bool:
    """Return whether a module is one of some paths, or in a folder of them."""
    return any(name == path or (path.endswith("/") and name.startswith(path)) for path in paths)


def words_of_code(tree: ast.AST) -> set[str]:
    """Return the names and texts of a module, docstrings aside."""
    statements = (node.value for node in nodes_of(tree) if isinstance(node, ast.Expr))
    docstrings = {id(value) for value in statements if isinstance(value, ast.Constant)}
    words: set[str] = set()
    for node in nodes_of(tree):
        match node:
            case ast.Constant(value=str(text)) if id(node) not in docstrings:
                words.add(text)
            case (
                ast.Name(id=name)
                | ast.Attribute(attr=name)
                | ast.alias(name=name)
                | ast.FunctionDef(name=name)
                | ast.ClassDef(name=name)
            ):
                words.add(name)
    return words


PARTS = {feature: (paths_in(deleted), paths_in(users)) for feature, deleted, users in rows(3)}


def test_the_table_has_parts():
    assert len(PARTS) == 4
    assert len(rows(2)) == 9


@pytest.mark.parametrize("part", PARTS)
def test_the_importers_of_a_part_are_listed(part):
    deleted, users = PARTS[part]
    assert {path for path in deleted if not (PACKAGE / path).exists()} == set()
    importers = {
        name_of(module)
        for module in MODULES
        if not belongs(name_of(module), deleted)
        if any(belongs(name, deleted) for name in imports_of(module))
    }
    assert importers == users


def test_modules_that_name_fuse_are_listed():
    deleted, users = next(paths for part, paths in PARTS.items() if part.startswith("`fuse`"))
    listed = {path for module, _ in rows(2) for path in paths_in(module)}
    naming = {
        name_of(module)
        for module in MODULES
        if any(NAMES_FUSE.search(word) for word in words_of_code(tree_of(module)))
    }
    others = {name for name in naming if not belongs(name, deleted)} - OTHER_MEANINGS
    assert others - users == listed


def test_paths_outside_the_package_exist():
    text = SECTION.partition("Outside the package")[2]
    paths = paths_in(text)
    assert len(paths) >= 13
    missing = {path for path in paths if not ((ROOT / path).exists() or (PACKAGE / path).exists())}
    assert missing == set()


@cache
def text_outside(path: Path) -> str:
    return path.read_text("utf-8")


@pytest.mark.parametrize("part", PARTS)
def test_the_pattern_of_a_part_finds_what_uses_it_outside_the_package(part):
    patterns = {name: pattern for name, *_, pattern in rows(4)}
    assert len(patterns) == len(PARTS)
    words = re.findall("`([^`]+)`", patterns[part.partition(",")[0]])
    pattern = re.compile(rf"\b({'|'.join(words)})\b")
    deleted, _ = PARTS[part]
    names = [name_of(module) for module in MODULES if belongs(name_of(module), deleted)]
    dotted = [re.escape(name.removesuffix(".py").replace("/", ".")) for name in names]
    used = re.compile(rf"salsanext_cli\.({'|'.join(dotted)})\b")
    files = [path for folder in OUTSIDE for path in (ROOT / folder).rglob("*.*")]
    users = [
        path for path in files if path.suffix in (".py", ".md") and used.search(text_outside(path))
    ]
    assert users
    assert [path for path in users if not pattern.search(text_outside(path))] == []
