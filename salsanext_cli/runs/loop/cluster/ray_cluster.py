# SPDX-License-Identifier: MIT
"""Ray as the driver of a cluster uses it: nodes, workers, and calls of them.

All uses of Ray are here, but those of code that runs on a node. Futures belong to threads of Ray.
"""

import logging
from concurrent.futures import Future
from typing import Any

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from salsanext_cli.runs.loop.cluster import node_code
from salsanext_cli.runs.loop.cluster.node_code import (
    NodeProblem,
    NodeRequirements,
    NodeWorker,
    node_problem,
)
from salsanext_cli.runs.loop.cluster.worker_size import Node, WorkerSize

NODE_LABEL = "ray.io/node-id"
LOSS_ERRORS = (ray.exceptions.RayError,)
"""Errors of calls whose worker, or result, is lost."""
RAISED_ERRORS = (ray.exceptions.RayTaskError,)
"""Errors among these of calls whose own code has raised an exception."""
NODE_ERRORS = (ray.exceptions.NodeDiedError, ray.exceptions.TaskUnschedulableError)
"""Errors among these of calls on a node that is lost."""
CONNECTION_ERRORS = (ConnectionError, ray.exceptions.RayError)
"""Errors of other calls after the loss of the cluster, if Ray does not end the process itself."""
JOIN_ERRORS = (OSError, ImportError, RuntimeError, ValueError, ray.exceptions.RayError)
"""Errors of `join`."""


def join(address: str) -> None:
    """Join a running cluster, or raise one of `JOIN_ERRORS`."""
    # A node without the package must be able to load the code of its check.
    ray.cloudpickle.register_pickle_by_value(node_code)
    ray.init(address=address, log_to_driver=False, logging_level=logging.CRITICAL)


def nodes() -> list[Node]:
    """Return the live nodes."""
    return [
        Node(
            id=node["NodeID"],
            name=f"{node['NodeManagerHostname']} ({node['NodeManagerAddress']})",
            cores=int(node["Resources"].get("CPU", 0)),
            gpus=int(node["Resources"].get("GPU", 0)),
            memory=int(node["Resources"].get("memory", 0)),
        )
        for node in ray.nodes()
        if node["Alive"]
    ]


def check(node: str, required: NodeRequirements) -> "Future[NodeProblem | None]":
    """Check a node, by its id, in a task that needs no core; the result is of `node_problem`."""
    place = NodeAffinitySchedulingStrategy(node, soft=False)
    options = {"num_cpus": 0, "max_retries": 0, "scheduling_strategy": place}
    return ray.remote(**options)(node_problem).remote(required).future()


def start_worker(size: WorkerSize, work: bytes, without: set[str]) -> Any:
    """Start a worker as soon as there is room for it, on any node but some; return its handle."""
    options: dict[str, Any] = {
        "num_cpus": size.cores,
        "num_gpus": size.gpus,
        "memory": size.memory,
        "max_restarts": 0,
        "max_task_retries": 0,
        "scheduling_strategy": "SPREAD",
    }
    if without:
        options["label_selector"] = {NODE_LABEL: f"!in({','.join(sorted(without))})"}
    return ray.remote(**options)(NodeWorker).remote(work, size.cores)


def call(worker: Any, method: str, *arguments: Any) -> "Future[Any]":
    """Call a method of a worker."""
    return getattr(worker, method).remote(*arguments).future()


def end(worker: Any) -> None:
    """End a worker, also one that has not started."""
    ray.kill(worker, no_restart=True)
