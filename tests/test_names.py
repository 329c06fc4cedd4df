# SPDX-License-Identifier: MIT
"""Names are the nouns that they stand for, and public functions state their contract."""

import ast
import inspect
import re
from importlib import import_module
from pathlib import Path

import pytest

import salsanext_cli

PACKAGE = Path(salsanext_cli.__file__).parent
PARTS = sorted({*PACKAGE.glob("*.py"), *(path.parent for path in PACKAGE.glob("*/__init__.py"))})
VAGUE = {"found", "own", "each", "kept", "those", "these", "what", "anew", "said", "told"}
VAGUE |= {"left_out"}
PRIVATE = re.compile("promis|guess|anew|_own_?$")
"""Words that the documentation has a standard term for."""
PUBLIC = [
    *(f"salsanext_cli.{home}" for home in salsanext_cli._HOMES),
    *(f"salsanext_cli.commands.stages.{path.stem}" for path in PACKAGE.glob("stages/[a-z]*.py")),
    *(
        "salsanext_cli.runs.loop.job",
        "salsanext_cli.runs.loop.run",
        "salsanext_cli.core.engines.backend",
    ),
]


def identifiers(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_names_are_nouns(part):
    for module in [part] if part.suffix else sorted(part.rglob("*.py")):
        names = set(identifiers(ast.parse(module.read_text("utf-8"))))
        assert {name for name in names if name in VAGUE or PRIVATE.search(name)} == set(), module


def contract(function):
    """Return the parameters of a function that its docstring must name, and its sections."""
    signature = inspect.signature(function)
    names = [name for name in signature.parameters if name not in ("self", "cls")]
    result = signature.return_annotation
    sections = ["Parameters"] if names else []
    if result not in (None, "None", "NoReturn", inspect.Signature.empty):
        is_iterator = re.match("(Iterator|Generator|Iterable)", str(result))
        sections.append("Yields" if is_iterator else "Returns")
    return names, sections


@pytest.mark.parametrize("home", PUBLIC)
def test_public_functions_have_sections(home):
    """Every parameter is described, and what is returned, in the sections of NumPy docstrings."""
    module = import_module(home)
    exported = salsanext_cli._HOMES.get(home.removeprefix("salsanext_cli."), vars(module))
    for name in exported:
        function = getattr(module, name)
        is_public = inspect.isfunction(function) and not name.startswith("_")
        if not is_public or function.__module__ != home:
            continue
        text = inspect.getdoc(function)
        names, sections = contract(function)
        lacking = [name for name in sections if f"\n{name}\n{'-' * len(name)}\n" not in text]
        lacking += [
            name
            for name in names
            if not re.search(rf"^\*{{0,2}}{name}( :|,|$)", text, re.M)
            and not re.search(rf", \*{{0,2}}{name}( :|,|$)", text, re.M)
        ]
        assert lacking == [], f"{home}.{name}"
