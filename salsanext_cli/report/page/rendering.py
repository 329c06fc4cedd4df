# SPDX-License-Identifier: MIT
"""Templates of the page, in which every text is escaped."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from salsanext_cli.core.errors import printable

PAGE = "page.html"


def rendered(values: Mapping[str, object]) -> str:
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
    environment.globals["content_of"] = _content_of
    return environment


def _without_control_characters(value: Any) -> Any:
    """Return the value of an expression as a template prints it; markup and numbers stay."""
    return printable(value) if type(value) is str else value


def _content_of(name: str) -> Markup:
    """Return a file beside the templates, such as a script, as it is."""
    file = resources.files("salsanext_cli.report.page").joinpath("templates", name)
    return Markup(file.read_text("utf-8"))
