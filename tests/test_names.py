# SPDX-License-Identifier: MIT
"""Public functions state their contract."""

import inspect
import re
from importlib import import_module
from pathlib import Path

import pytest

import salsanext_cli

PACKAGE = Path(salsanext_cli.__file__).parent
PUBLIC = [
    *(f"salsanext_cli.{home}" for home in salsanext_cli._HOMES),
    *(
        f"salsanext_cli.commands.stages.{path.stem}"
        for path in PACKAGE.glob("commands/stages/[a-z]*.py")
    ),
    *(
        "salsanext_cli.runs.loop.job",
        "salsanext_cli.runs.loop.run",
        "salsanext_cli.core.engines.backend",
    ),
]


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
