# SPDX-License-Identifier: MIT
"""Runs on a Ray cluster of two nodes: the bytes are the same, and deaths are survived."""

import socket
import sys
from pathlib import Path

import pytest
from scans import files_below, refused, write_sequence
from worker_runs import run
from worker_tasks import Write, scans_of

from salsanext_cli.commands.line.options.option_names import CommandLine
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.errors import MissingDependency, UsageError, WorkersLost
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.wording import spelled
from salsanext_cli.runs.loop.cluster import attempts, driver_process
from salsanext_cli.runs.loop.cluster.bug import Bug
from salsanext_cli.runs.loop.cluster.chunk_queue import ChunkQueue
from salsanext_cli.runs.loop.cluster.messages import (
    Alive,
    FinishedChunk,
    Joined,
    LongChunk,
    LongChunks,
    LostCluster,
    LostWorker,
    UnusableNode,
)
from salsanext_cli.runs.loop.network_task import NetworkTask
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings

HERE = "127.0.0.1"


@pytest.mark.slow
def test_the_bytes_are_those_of_one_process(tmp_path, full_weights, cluster, caplog, capfd):
    write_sequence(tmp_path / "sequences/00", ["000000"], seed=7)
    write_sequence(tmp_path / "sequences/08", ["000000", "000001", "000002"])
    settings = NetworkSettings(full_weights, "cpu")
    caplog.set_level(NOTICE)
    written = []
    for name, options in (("alone", RunOptions()), ("c", RunOptions(cluster=cluster.address))):
        predict_scans(tmp_path, tmp_path / name, settings=settings, options=options)
        written.append(files_below(tmp_path / name))
    assert written[0] == written[1]
    assert len(written[0]) > 8
    assert f"cluster {cluster.address}: room for 2 workers on " in caplog.text
    assert capfd.readouterr().out == ""


@pytest.mark.slow
def test_a_scan_that_kills_its_workers_has_failed_and_the_others_are_done(
    tmp_path, cluster, monkeypatch, caplog
):
    """Relative names start where the run was started."""
    monkeypatch.chdir(tmp_path)
    names = [f"{number:02d}" for number in range(7)]
    scans = scans_of(*names[:4], "killed", "bad", *names[4:])
    outcome = run(Write(Path("out")), scans, cluster=cluster.address)
    assert [failure.scan.stem for failure in outcome.failures] == ["bad", "killed"]
    assert [failure.code for failure in outcome.failures] == ["format", "workers-lost"]
    assert sorted(path.name for path in Path("out/s").iterdir()) == names
    assert "a worker ended" in caplog.text


@pytest.mark.slow
def test_a_bug_keeps_its_type_and_the_traceback_of_the_worker(tmp_path, cluster):
    with pytest.raises(ZeroDivisionError, match="a bug of ours") as caught:
        run(Write(tmp_path), scans_of("a", "bug", "b"), cluster=cluster.address)
    assert "in __call__" in caught.value.__notes__[0]


def closed_port():
    """Return a port of this machine at which nothing listens."""
    with socket.create_server((HERE, 0)) as unused:
        return unused.getsockname()[1]


def test_where_no_cluster_answers(tmp_path):
    address = f"{HERE}:{closed_port()}"
    with spelled(CommandLine()):
        caught = refused(
            UsageError, f"--cluster {address}", run, Write(tmp_path), scans_of("a"), cluster=address
        )
    assert f"ray start --address={address}" in caught.value.hint


def test_the_end_of_a_driver_is_no_silence(tmp_path, monkeypatch):
    monkeypatch.setattr(attempts, "find_spec", lambda name: name)
    crash = "import sys; print('before', file=sys.stderr); sys.exit('out of threads')"
    monkeypatch.setattr(driver_process, "PROGRAM", crash)
    caught = refused(
        UsageError, 'cluster="auto"', run, Write(tmp_path), scans_of("a"), cluster="auto"
    )
    assert "status 1: out of threads" in caught.value.problem


class Answers:
    """Driver that has sent some messages before it ended."""

    def __init__(self, *messages):
        self.answers = iter(messages)

    def messages(self):
        return self.answers

    def ending(self):
        return "ended with status 1: out of memory"


def test_the_end_of_a_driver_and_the_loss_of_the_cluster_are_told_apart(tmp_path):
    queue = ChunkQueue([tuple(scans_of("a"))])
    for messages, problem in (([], "ended with status 1"), ([LostCluster(problem="gone")], "gone")):
        driver = Answers(*messages)
        with pytest.raises(WorkersLost, match=problem):
            next(attempts._attempts(driver, driver.messages(), queue, "auto"))
        driver = Answers(*messages)
        with pytest.raises(UsageError, match=problem):
            attempts._joined(driver, driver.messages(), "auto")


def test_a_bug_of_one_node_is_no_bug_of_the_next_and_is_raised_if_it_is():
    queue = ChunkQueue([tuple(scans_of("a"))])
    bug = Bug.packed(ZeroDivisionError("of a node"), "in attempt")
    queue.send()
    assert attempts.unpacked(queue, FinishedChunk(number=1, attempts=bug, node="n")) == []
    assert queue.send().lost_on == "n"
    with pytest.raises(ZeroDivisionError, match="of a node"):
        attempts.unpacked(queue, FinishedChunk(number=2, attempts=bug, node="m"))


@pytest.mark.parametrize(
    ("trace", "error", "shown"),
    [("", WorkersLost, "cannot begin"), ("in open", RuntimeError, "in open")],
)
def test_a_bug_at_the_last_node_shows_its_traceback(trace, error, shown):
    left_out = UnusableNode(node="n", problem="cannot begin: bug", trace=trace, ends_run=True)
    with pytest.raises(error, match=shown):
        attempts._report(left_out, "auto")


def test_the_address_of_a_variable_is_checked_too(tmp_path, monkeypatch):
    """Ray would start a cluster of its own."""
    monkeypatch.setenv("RAY_ADDRESS", "local")
    refused(UsageError, "RAY_ADDRESS", run, Write(tmp_path), scans_of("a"), cluster="auto")
    monkeypatch.setenv("RAY_ADDRESS", "host:6379")
    attempts.require_address("auto")


def test_nodes_that_the_run_skips_come_before_the_others(caplog):
    skipped = UnusableNode(node="n", problem="did not answer within 60 s")
    driver = Answers(Alive(), skipped, Alive(), Joined(nodes=1, workers=2))
    assert attempts._joined(driver, driver.messages(), "auto").workers == 2
    assert "n did not answer" in caplog.text


def test_a_worker_that_is_lost_is_charged_only_with_what_it_had_started(caplog):
    queue = ChunkQueue([tuple(scans_of("a", "b")), tuple(scans_of("c"))])
    started = queue.send()
    waiting = queue.send()
    lost = LostWorker(node="n", chunks=(started.number,), spared=(waiting.number,))
    assert [*attempts.failed_attempts(queue, lost)] == []
    again = [queue.send(), queue.send()]
    assert [chunk.scans for chunk in again] == [started.scans, waiting.scans]
    assert [chunk.is_alone for chunk in again] == [True, False]
    assert "a worker ended" in caplog.text


def test_a_chunk_that_takes_long_is_one_line_that_names_the_process_and_the_scans(caplog):
    caplog.set_level(NOTICE)
    queue = ChunkQueue([tuple(scans_of("a", "b"))])
    chunk = LongChunk(number=queue.send().number, node="n", process=4711, seconds=960.0)
    driver = Answers(LongChunks(chunks=(chunk, chunk, chunk)), LostCluster(problem="gone"))
    with pytest.raises(WorkersLost):
        next(attempts._attempts(driver, driver.messages(), queue, "auto"))
    (line,) = [record.getMessage() for record in caplog.records]
    for words in (
        "node n",
        "process 4711",
        "16 min",
        "s/a, s/b",
        "(2 other workers have taken as long)",
    ):
        assert words in line


def test_what_all_nodes_lack_is_named():
    assert "GPU" in attempts.no_room(has_gpu=True)
    assert "GPU" not in attempts.no_room(has_gpu=False)


@pytest.mark.parametrize(
    "address", ["", "nonsense", "local", "host", "host:x", "http://host:1", "a b:1", "ray://host"]
)
def test_what_is_no_address_is_refused(tmp_path, address):
    refused(UsageError, "cluster", run, Write(tmp_path), scans_of("a"), cluster=address)


def test_the_hint_says_how_to_start_a_cluster():
    for address, command in (
        ("auto", "ray start --head"),
        ("node1:6379", "on node1: ray start --head --port=6379"),
        ("ray://node1:10001", "on node1: ray start --head --ray-client-server-port=10001"),
    ):
        assert command in attempts.starting_hint(address)


def test_the_hint_about_other_versions_of_ray_is_to_install_the_same_ones():
    problem = "Version mismatch: The cluster was started with: Ray: 2.51"
    assert "same versions" in attempts.joining_hint("auto", problem)
    assert "ray start" in attempts.joining_hint("auto", "Could not find any running Ray instance")


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(attempts, "find_spec", lambda name: None)
    monkeypatch.setitem(sys.modules, "ray", None)
    refused(MissingDependency, "ray", run, Write(tmp_path), scans_of("a"), cluster="auto")


def test_workers_of_a_network_on_gpus_get_one_each():
    def of(device):
        return NetworkTask(job=len, settings=NetworkSettings(None, device))

    assert not attempts.uses_gpu(len)
    assert not attempts.uses_gpu(of("cpu"))
    assert attempts.uses_gpu(of("cuda"))
    assert attempts.uses_gpu(of("auto"))
    refused(UsageError, 'device="cuda:1"', attempts.uses_gpu, of("cuda:1"))
    # A node whose torch finds no GPU cannot open the task, instead of computing on its CPU.
    for device, expected in (("auto", "cuda"), ("cuda", "cuda"), ("cpu", "cpu")):
        assert attempts.task_of_nodes(of(device)).settings.device == expected
    assert attempts.task_of_nodes(len) is len


def test_only_networks_in_int8_need_cpus_of_one_kind():
    def of(precision):
        return NetworkTask(job=len, settings=NetworkSettings(precision=precision))

    assert [attempts.computes_int8(task) for task in (of("int8"), of("bfloat16"), len)] == [
        True,
        False,
        False,
    ]
