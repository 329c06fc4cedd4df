# SPDX-License-Identifier: MIT
"""Templates of the page, in which every text is escaped, and its scripts."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from salsanext_cli.core.texts import printable

FOLDER = resources.files("salsanext_cli.report.page")
PAGE = "page.html"
IMPORTED_BESIDE = 'from "./'  # How a script imports one beside it
IMPORTED_BY_NAME = 'from "page/'
"""How a script in an address imports another one: an address has no folder."""


def render(values: Mapping[str, object]) -> str:
    """Return the page with values in place of the names in its templates.

    Parameters
    ----------
    values : mapping of str to object
        Texts, records and plain data by the names that the templates use.

    Returns
    -------
    str
        HTML; markup and control characters in texts are escaped.

    Raises
    ------
    jinja2.UndefinedError
        If a template uses a name without a value.
    """
    return _environment().get_template(PAGE).render(values)


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("salsanext_cli.report.page"),
        autoescape=True,
        finalize=_without_control_characters,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    environment.globals |= {"style": _style, "import_map": import_map}
    return environment


def _without_control_characters(value: Any) -> Any:
    """Return the value of an expression as a template prints it; markup and numbers stay."""
    return printable(value) if type(value) is str else value


def _style() -> Markup:
    """Return the style sheet as it is."""
    return Markup(FOLDER.joinpath("templates/page.css").read_text("utf-8"))


def import_map() -> dict[str, dict[str, str]]:
    """Return the import map of the page: the address of each script by its name.

    The addresses contain the scripts, so that the page is one file.
    """
    scripts = sorted(FOLDER.joinpath("scripts").iterdir(), key=lambda script: script.name)
    return {"imports": {f"page/{script.name}": _address(script) for script in scripts}}


def _address(script: Traversable) -> str:
    """Return an address that contains a script."""
    source = script.read_text("utf-8").replace(IMPORTED_BESIDE, IMPORTED_BY_NAME)
    return f"data:text/javascript;base64,{b64encode(source.encode()).decode('ascii')}"
