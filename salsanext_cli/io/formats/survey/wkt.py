# SPDX-License-Identifier: MIT
"""Coordinate systems as text (WKT 1 and 2), as nested nodes."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

TOKEN = re.compile(
    r"""(?P<keyword>[A-Za-z_]\w*)\s*[\[(]|(?P<end>[\])])|"(?P<text>[^"]*)"|(?P<other>[^\[\]()",\s]+)"""
)
MAX_DEPTH = 64  # Of nested nodes; real systems have fewer than 10


@dataclass(frozen=True, slots=True, kw_only=True)
class WktNode:
    """Node of a text in WKT, such as `UNIT["metre",1]`."""

    keyword: str  # In upper case
    values: list[str] = field(default_factory=list)  # Names and numbers, without quotes
    nodes: list[WktNode] = field(default_factory=list)

    def children(self, keywords: Collection[str]) -> list[WktNode]:
        """Return the nodes directly below with one of the keywords."""
        return [node for node in self.nodes if node.keyword in keywords]

    def first(self, keywords: Collection[str]) -> WktNode | None:
        """Return the first node at any depth with one of the keywords; outer nodes come first."""
        return next((node for node in self._below() if node.keyword in keywords), None)

    def _below(self) -> Iterator[WktNode]:
        """Yield all nodes below this one, each before its own nodes."""
        for node in self.nodes:
            yield node
            yield from node._below()


def read_wkt(text: str) -> WktNode:
    """Return a node without a keyword, whose nodes are those of a text.

    Brackets that are not closed end with the text.
    """
    root = WktNode(keyword="")
    open_nodes = [root]
    for token in TOKEN.finditer(text):
        if token["keyword"] and len(open_nodes) < MAX_DEPTH:
            node = WktNode(keyword=token["keyword"].upper())
            open_nodes[-1].nodes.append(node)
            open_nodes.append(node)
        elif token["keyword"]:
            raise ValueError(f"its coordinate system has more than {MAX_DEPTH} nested nodes")
        elif not token["end"]:
            open_nodes[-1].values.append(token["text"] or token["other"] or "")
        elif len(open_nodes) > 1:
            open_nodes.pop()
    return root
