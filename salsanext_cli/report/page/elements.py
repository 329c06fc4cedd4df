# SPDX-License-Identifier: MIT
"""Elements of a page: escaped text, lists, bars and data for scripts."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape

from salsanext_cli.core.errors import printable


def text_of(text: object) -> str:
    """Return text without markup and control characters."""
    return escape(printable(str(text)))


def listed(heading: str, start: str, end: str, lines: Sequence[str]) -> str:
    """Return a heading and a list of lines; empty without lines."""
    if not lines:
        return ""
    items = "".join(f"<li>{text_of(line)}</li>" for line in lines)
    return f"<h3>{heading}</h3>{start}{items}{end}"


def bar(share: float, rgb: str) -> str:
    """Return a bar whose length is a share, 0…1, of the widest one."""
    return f'<i style="width:{65 * share:.1f}%;background:rgb({rgb})"></i> '


def script_data(identifier: str, data: object) -> str:
    """Return plain data as an element for scripts; no text in it can end the element."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    for mark in "<>&":
        text = text.replace(mark, f"\\u{ord(mark):04x}")
    return f'<script type="application/json" id="{identifier}">{text}</script>\n'
