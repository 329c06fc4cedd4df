# SPDX-License-Identifier: MIT
"""Nodes of a cluster as a run uses them: their names, their checks, and which it has excluded."""

import time
from collections.abc import Sequence
from concurrent.futures import Future, wait
from dataclasses import replace
from typing import Any

from salsanext_cli.runs.loop.cluster.error_lines import cause_line
from salsanext_cli.runs.loop.cluster.messages import Alive, Send, UnusableNode
from salsanext_cli.runs.loop.cluster.node_code import VERSIONS_HINT, NodeProblem, NodeRequirements
from salsanext_cli.runs.loop.cluster.worker_size import Node

CHECK_TIMEOUT_S = 60.0  # For the checks of all nodes, and for that of a single one
CHECK_HINT = "see the state of the cluster with: ray status"
NODE_INTERVAL_S = 2.0  # Between looks at the nodes


class Nodes:
    """Nodes of a cluster.

    Parameters
    ----------
    cluster : module
        `ray_cluster`, or what stands for it.
    required : NodeRequirements
        What each node needs.
    send : callable
        Sends a message to the main process.
    """

    def __init__(self, cluster: Any, required: NodeRequirements, send: Send) -> None:
        self.cluster = cluster
        self.required = required
        self.send = send
        self.unusable: set[str] = set()  # Ids of excluded nodes
        self._names: dict[str, str] = {}  # By id

    def usable(self) -> list[Node]:
        """Return the live nodes that are not excluded."""
        nodes = [node for node in self.cluster.nodes() if node.id not in self.unusable]
        self._names.update((node.id, node.name) for node in nodes)
        return nodes

    def listed(self) -> frozenset[str]:
        """Return the ids of the live nodes."""
        return frozenset(node.id for node in self.cluster.nodes())

    def name(self, node: str) -> str:
        """Return the name of a node by its id, also of one that is no more."""
        return self._names.get(node, node)

    def check(self, node: str) -> "Future[NodeProblem | None]":
        """Check a node, by its id."""
        future: Future[NodeProblem | None] = self.cluster.check(node, self.required)
        return future

    def report(self, node: str, problem: NodeProblem) -> UnusableNode:
        """Return the message about a node, by its id, that lacks something."""
        return UnusableNode(
            node=self.name(node), problem=problem.text, hint=problem.hint, trace=problem.trace
        )

    def begin(self, nodes: Sequence[Node]) -> bool:
        """Check nodes before the first scan; return whether none of them ends the run.

        One that does not answer is excluded, unless it is the last.
        """
        checks = {node.id: self.check(node.id) for node in nodes}
        end = time.monotonic() + CHECK_TIMEOUT_S
        for node, checked in checks.items():
            try:
                problem = self._answer(checked, end)
            except TimeoutError:
                text = f"did not answer within {CHECK_TIMEOUT_S:.0f} s"
                problem = NodeProblem(text=text, hint=CHECK_HINT)
                self.unusable.add(node)
                if len(self.unusable) < len(checks):
                    self.send(self.report(node, problem))
                    continue
            if problem:
                self.send(replace(self.report(node, problem), ends_run=True))
                return False
        return True

    def _answer(self, checked: "Future[NodeProblem | None]", end: float) -> NodeProblem | None:
        """Return the answer of a check, or raise `TimeoutError` at the time `end`."""
        remaining_s = end - time.monotonic()
        while not checked.done() and remaining_s > 0:
            self.send(Alive())
            wait([checked], min(remaining_s, NODE_INTERVAL_S))
            remaining_s = end - time.monotonic()
        try:
            return checked.result(0.0)
        except self.cluster.RAISED_ERRORS as error:
            text = f"cannot be checked: {cause_line(error)}"
            return NodeProblem(text=text, hint=VERSIONS_HINT)
        except self.cluster.LOSS_ERRORS:
            return None  # The node has gone; a worker on one that comes back checks it.
