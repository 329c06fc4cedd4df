# SPDX-License-Identifier: MIT
"""Tables as they are printed."""

import io

from rich.console import Console, Group
from rich.table import Table


def text_of(*tables: Table, width: int = 120) -> str:
    """Return tables as a terminal of a width shows them."""
    text = io.StringIO()
    Console(file=text, width=width).print(Group(*tables))
    return text.getvalue()
