# SPDX-License-Identifier: MIT
"""Attempts of the workers of a cluster, as `pool.attempts_of_workers` yields those of processes.

The chunks of a lost worker are sent again, each to a worker that has no other one: which chunk has
ended the first worker is not known. After a second loss the scans of a chunk are sent one by one. A
scan that was then lost twice has failed. The other scans go on, and nodes may come and go.
"""

import logging
import os
import pickle
import re
import socket
from collections.abc import Generator, Iterator, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from uuid import uuid4

from salsanext_cli.core import wording
from salsanext_cli.core.engines.device import int8_arithmetic
from salsanext_cli.core.errors import UsageError, WorkersLost
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.core.texts import counted, first_few, shortened
from salsanext_cli.io.files.atomic import MARK
from salsanext_cli.runs.loop.cluster.bug import Bug
from salsanext_cli.runs.loop.cluster.chunk_queue import MAX_LOSSES, MAX_LOST_NODES, ChunkQueue
from salsanext_cli.runs.loop.cluster.driver_process import DriverProcess, driver_process
from salsanext_cli.runs.loop.cluster.messages import (
    Alive,
    Assignment,
    Crash,
    FinishedChunk,
    FreePlaces,
    Joined,
    LongChunk,
    LongChunks,
    LostCluster,
    LostWorker,
    NotJoined,
    PackedChunk,
    UnusableNode,
    Waiting,
)
from salsanext_cli.runs.loop.cluster.node_requirements import node_requirements
from salsanext_cli.runs.loop.cluster.work import Work
from salsanext_cli.runs.loop.job import Attempt, OpenableTask, Task
from salsanext_cli.runs.loop.job_memory import MIN_BYTES
from salsanext_cli.runs.loop.network_task import NetworkTask
from salsanext_cli.runs.loop.pool import MAX_CHUNK_SCANS, WorkerProcess, chunks
from salsanext_cli.runs.loop.run_folders import RunFolders
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.scans.scan_file import ScanFile

ADDRESS = re.compile(r"auto|(?P<client>ray://)?(?P<host>[^\s/:]+|\[[^\s/]+\]):(?P<port>\d{1,5})")
ADDRESS_VARIABLE = "RAY_ADDRESS"  # Of Ray
CONNECT_TIMEOUT_S = 15.0
MAX_PROBLEM_CHARACTERS = 300  # Of an error of Ray; its mismatch of versions takes 200
UNUSED_GPUS = "its GPUs are not used: workers get the device of this machine, which is cpu"
EXPECTED_ADDRESS = "auto, HOST:PORT or ray://HOST:PORT"

log = logging.getLogger(__name__)


def attempts_of_cluster(
    task: Task, scans: Sequence[ScanFile], options: RunOptions, folders: RunFolders
) -> Generator[Attempt[Any], None, None]:
    """Yield the attempts of workers on a cluster, which end when this is closed, in any order.

    Parameters
    ----------
    task : callable
        Work on each scan, which can be pickled.
    scans : sequence of ScanFile
        Scans to attempt.
    options : RunOptions
        Its `cluster` is the address.
    folders : RunFolders
        Folders that the workers write into and read from.

    Yields
    ------
    Attempt

    Raises
    ------
    UsageError
        If there is no such cluster, or one of its nodes lacks what the run needs.
    WorkersLost
        If the cluster is lost, or none of its nodes can open the task.
    """
    address = str(options.cluster)
    require_address(address)
    require_listener(address)
    if find_spec("ray") is None:
        import_extra("ray", "ray")
    process = WorkerProcess(
        run_id=uuid4().hex, mark=MARK.get(), folder=Path.cwd(), spelling=wording.used()
    )
    has_gpu = uses_gpu(task)
    task = task_of_nodes(task)
    work = Work(task=task, process=process, stop=options.on_error == "stop")
    most = task.max_chunk_scans if isinstance(task, OpenableTask) else MAX_CHUNK_SCANS
    arithmetic = int8_arithmetic() if computes_int8(task) else ""
    with node_requirements(scans, folders, arithmetic) as required, driver_process() as driver:
        assignment = Assignment(
            address=address,
            work=pickle.dumps(work),
            required=required,
            scans=len(scans),
            worker_memory=task.worker_memory if isinstance(task, NetworkTask) else MIN_BYTES,
            uses_gpu=has_gpu,
        )
        driver.send(assignment)
        messages = driver.messages()
        joined = _joined(driver, messages, address)
        if not joined.workers:
            log.warning("cluster %s: %s", address, no_room(has_gpu))
        if joined.unused_gpus and isinstance(task, NetworkTask):
            log.log(NOTICE, "cluster %s: %s", address, UNUSED_GPUS)
        queue = ChunkQueue(chunks(scans, max(1, joined.workers), most))
        yield from _attempts(driver, messages, queue, address)


def require_address(address: str) -> None:
    """Refuse what is no address of a cluster; `auto` is that of a variable of Ray, if it is set.

    Ray would start a cluster of its own for some values.
    """
    subject = wording.argument("cluster")
    if address == "auto" and os.environ.get(ADDRESS_VARIABLE):
        subject = ADDRESS_VARIABLE
        address = os.environ[ADDRESS_VARIABLE]
    if not ADDRESS.fullmatch(address):
        raise UsageError(subject, f"is {address!r}", EXPECTED_ADDRESS, starting_hint("auto"))


def require_listener(address: str) -> None:
    """Refuse an address at which nothing listens, for which Ray would wait."""
    parts = ADDRESS.fullmatch(address)
    if parts is None or parts["host"] is None:
        return
    peer = (parts["host"].strip("[]"), int(parts["port"]))
    try:
        socket.create_connection(peer, CONNECT_TIMEOUT_S).close()
    except (OSError, OverflowError) as error:
        raise _not_joined(address, f"cannot be reached: {error}") from error


def _not_joined(address: str, problem: str) -> UsageError:
    subject = wording.setting("cluster", address)
    text = shortened(problem, MAX_PROBLEM_CHARACTERS)
    return UsageError(subject, text, "a running Ray cluster", joining_hint(address, problem))


def joining_hint(address: str, problem: str) -> str:
    """Return what to do about a cluster that cannot be joined, by the error of Ray."""
    if "version" in problem.lower():
        return "install the same versions of Ray and Python on all machines"
    return starting_hint(address)


def starting_hint(address: str) -> str:
    """Return what to type to start a cluster with this address."""
    parts = ADDRESS.fullmatch(address)
    if parts is None or parts["host"] is None:
        return "start a cluster on this machine: ray start --head"
    host = parts["host"]
    port = parts["port"]
    if parts["client"]:
        return f"start it on {host}: ray start --head --ray-client-server-port={port}"
    return (
        f"on {host}: ray start --head --port={port}; on this machine: ray start --address={address}"
    )


def uses_gpu(task: Task) -> bool:
    """Return whether each worker needs a GPU; refuse a GPU with a number, which is of one node."""
    if not isinstance(task, NetworkTask):
        return False
    device = task.settings.device
    if device.startswith("cuda:"):
        subject = wording.setting("device", device)
        hint = f"use {wording.setting('device', 'cuda')}; each worker gets a GPU"
        raise UsageError(subject, "names a GPU of one machine", hint=hint)
    return device != "cpu"


def task_of_nodes(task: Task) -> Task:
    """Return a task whose workers need a GPU if the network of this machine is on one."""
    if not (isinstance(task, NetworkTask) and uses_gpu(task)):
        return task
    return replace(task, settings=replace(task.settings, device="cuda"))


def computes_int8(task: Task) -> bool:
    """Return whether a network computes in int8."""
    return isinstance(task, NetworkTask) and task.settings.precision == "int8"


def no_room(has_gpu: bool) -> str:
    """Return what all nodes of a cluster lack, in words; `has_gpu`: whether a worker needs one."""
    if not has_gpu:
        return "no node has the cores and memory for a worker; the run waits until one comes"
    setting = wording.setting("device", "cpu")
    return f"no node has a GPU; the run waits until one comes; use {setting} to run without"


def _joined(driver: DriverProcess, messages: Iterator[Any], address: str) -> Joined:
    """Return the answer of the driver, or raise why it could not join the cluster."""
    subject = wording.setting("cluster", address)
    message = next(messages, None)
    while isinstance(message, Alive) or (
        isinstance(message, UnusableNode) and not message.ends_run
    ):
        _report(message, address)
        message = next(messages, None)
    match message:
        case Joined() as joined:
            text = f"{counted(joined.workers, 'worker')} on {counted(joined.nodes, 'node')}"
            log.log(NOTICE, "cluster %s: room for %s", address, text)
            return joined
        case UnusableNode(node=node, problem=problem, hint=hint):
            raise UsageError(subject, f"node {node} {problem}", hint=hint)
        case NotJoined(problem=problem) | LostCluster(problem=problem):
            raise _not_joined(address, problem)
        case Crash(trace=trace):
            raise RuntimeError(trace)
    raise _not_joined(address, f"the driver {driver.ending()}")


def _attempts(
    driver: DriverProcess, messages: Iterator[Any], queue: ChunkQueue, address: str
) -> Generator[Attempt[Any], None, None]:
    """Send all chunks of a queue to the driver, and yield their attempts."""
    free_places = 0
    while queue:
        message = next(messages, None) or LostCluster(problem=f"the driver {driver.ending()}")
        match message:
            case FreePlaces(count=count):
                free_places += count
            case FinishedChunk():
                yield from unpacked(queue, message)
            case LostWorker():
                yield from failed_attempts(queue, message)
            case LongChunks(chunks=chunks):
                log.log(NOTICE, "%s", long_chunks_line(queue, chunks))
            case _:
                _report(message, address)
        while free_places and queue.is_waiting:
            free_places -= 1
            chunk = queue.send()
            scans = pickle.dumps(chunk.scans)
            packed = PackedChunk(
                number=chunk.number,
                scans=scans,
                is_alone=chunk.is_alone,
                owns_node=chunk.owns_node,
                lost_on=chunk.lost_on,
            )
            driver.send(packed)


def unpacked(queue: ChunkQueue, finished: FinishedChunk) -> list[Attempt[Any]]:
    """Return the attempts of a worker.

    After an exception that no user can correct, the chunk waits again, for another node if there
    is one; a second one is raised.
    """
    result = pickle.loads(finished.attempts)  # noqa: S301 - of a worker of this run
    if not isinstance(result, Bug):
        queue.finish(finished.number)
        return list(result.attempts)
    if not queue.retry(finished.number, finished.node):
        raise result.noted()
    error = type(result.error).__name__
    log.warning("node %s: %s; another worker gets its scans", finished.node, error)
    return []


def failed_attempts(queue: ChunkQueue, lost: LostWorker) -> Iterator[Attempt[Any]]:
    """Let the chunks of a lost worker wait again; yield the attempt of a scan that has failed."""
    lost_part = "it cannot go on" if lost.is_node_lost else "a worker ended"
    log.warning("node %s: %s; other workers get its scans", lost.node, lost_part)
    deaths = counted(MAX_LOST_NODES, "node") if lost.is_node_lost else counted(MAX_LOSSES, "worker")
    # The first chunk was sent first, and is the next again.
    failed = [queue.spare(number, lost.node) for number in reversed(lost.spared)]
    failed += [
        queue.lose(number, is_node_lost=lost.is_node_lost, node=lost.node)
        for number in reversed(lost.chunks)
    ]
    for scan in failed:
        if scan is not None:
            hint = f"it may need more memory; try it alone with {wording.setting('jobs', 1)}"
            error = WorkersLost(scan.path, f"was alone on {deaths} that died", hint=hint)
            yield Attempt(file=scan, error=error)


def long_chunks_line(queue: ChunkQueue, chunks: Sequence[LongChunk]) -> str:
    """Return the line about chunks that take long: the first, and the number of others."""
    first = chunks[0]
    scans = first_few([scan.name for scan in queue.scans(first.number)])
    worker = f"node {first.node}: process {first.process}"
    others = ""
    if len(chunks) > 1:
        verb = "has" if len(chunks) == 2 else "have"
        others = f" ({counted(len(chunks) - 1, 'other worker')} {verb} taken as long)"
    return (
        f"{worker} has worked for {first.seconds / 60:.0f} min on {scans}{others}; "
        "if you end it, other workers get its scans"
    )


def _report(message: object, address: str) -> None:
    """Log a message of the driver about the cluster, or raise the error that ends the run."""
    subject = wording.setting("cluster", address)
    match message:
        case Alive():
            pass
        case UnusableNode(node=node, trace=trace, ends_run=True) if trace:
            raise RuntimeError(f"node {node}: {trace}")
        case UnusableNode(node=node, problem=problem, hint=hint, ends_run=True):
            raise WorkersLost(subject, f"node {node} {problem}", hint=hint)
        case UnusableNode(node=node, problem=problem):
            log.warning("node %s %s; the run goes on without it", node, problem)
        case Waiting(seconds=seconds, room=room):
            text = "no free worker for %.0f s; waiting for a node with %s"
            log.log(NOTICE, f"cluster %s: {text}", address, seconds, room)
        case LostCluster(problem=problem):
            raise WorkersLost(subject, problem, hint=starting_hint(address))
        case Crash(trace=trace):
            raise RuntimeError(trace)
        case _:
            raise TypeError(message)
