# SPDX-License-Identifier: MIT
"""Nodes that come, go, or lack something, while a run goes on; each has a cluster of its own."""

import os
import subprocess
import sys
import threading
import time
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest
from scans import refused
from worker_runs import run
from worker_tasks import Write, scans_of

from salsanext_cli.core.errors import UsageError, WorkersLost
from salsanext_cli.io.files.atomic import MARK
from salsanext_cli.runs.loop.cluster.attempts import attempts_of_cluster
from salsanext_cli.runs.loop.run import RunOptions, run_over_scans
from salsanext_cli.runs.loop.run_folders import RunFolders
from salsanext_cli.runs.scans.scan_file import ScanFile

pytestmark = pytest.mark.slow
TESTS = Path(__file__).parents[3]
MAX_WAIT_S = 120.0  # For others, on a machine with much other work
NAMES = [f"{number:02d}" for number in range(40)]


def done(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "s").glob("[!.]*"))


def wait_for(condition):
    end = time.monotonic() + MAX_WAIT_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def meanwhile(act):
    """Run something in a thread."""
    thread = threading.Thread(target=act)
    thread.start()
    return thread


def test_the_scans_of_a_node_that_dies_are_attempted_by_others(
    tmp_path, cluster, extra_node, caplog
):
    node = extra_node()

    def kill():
        wait_for(lambda: len(done(tmp_path)) > 8)
        cluster.remove_node(node, allow_graceful=False)

    thread = meanwhile(kill)
    outcome = run(Write(tmp_path, 0.3), scans_of(*NAMES), cluster=cluster.address)
    thread.join()
    assert outcome.failures == ()
    assert done(tmp_path) == NAMES
    assert "a worker ended" in caplog.text


class MeetAnotherNode:
    """Work that waits until scans are on two nodes."""

    def __init__(self, out: Path) -> None:
        self.out = out

    def __call__(self, scan: ScanFile) -> str:
        import ray

        node = ray.get_runtime_context().get_node_id()
        (self.out / node).touch()
        if scan.stem > NAMES[0]:
            wait_for(lambda: len([*self.out.iterdir()]) > 1)
        return node


class AddAtTheFirstResult:
    """Function of results that adds a node at the first one; only the main thread can."""

    def __init__(self, add) -> None:
        self.add = add
        self.results = []

    def __call__(self, result) -> None:
        if not self.results:
            self.add()
        self.results.append(result)


def test_a_node_that_comes_later_gets_scans(tmp_path, cluster, extra_node):
    note = AddAtTheFirstResult(extra_node)
    options = RunOptions(cluster=cluster.address)
    scans = [*scans_of(NAMES[0], sequence="first"), *scans_of(*NAMES[1:])]
    run_over_scans(MeetAnotherNode(tmp_path), scans, options, on_result=note)
    assert len(note.results) == len(NAMES)
    assert len(set(note.results)) == 2


def package_of_version(folder: Path, version: str) -> dict[str, str]:
    """Write a package of another version; return the variable by which a node finds it."""
    module = folder / "salsanext_cli/version.py"
    module.parent.mkdir(parents=True)
    (module.parent / "__init__.py").write_text("")
    module.write_text(f"__version__ = {version!r}\n")
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    return {"PYTHONPATH": path}


def test_a_node_with_another_version_is_named_before_the_first_scan(tmp_path, cluster, extra_node):
    extra_node(env_vars=package_of_version(tmp_path / "old", "0.0.1"))
    caught = refused(
        UsageError,
        f'cluster="{cluster.address}"',
        run,
        Write(tmp_path),
        scans_of("a"),
        cluster=cluster.address,
    )
    assert "has salsanext 0.0.1" in caught.value.problem
    assert not done(tmp_path)


class WaitAtTheEnd(Write):
    """Work whose last scan waits for a file."""

    def __call__(self, scan: ScanFile) -> str:
        if scan.stem == NAMES[-1]:
            wait_for((self.out / "go-on").exists)
        return super().__call__(scan)


def test_a_later_node_with_another_version_is_left_out(tmp_path, cluster, extra_node, caplog):
    variables = package_of_version(tmp_path / "old", "0.0.1")
    note = AddAtTheFirstResult(partial(extra_node, env_vars=variables))

    def go_on():
        wait_for(lambda: "has salsanext 0.0.1" in caplog.text)
        (tmp_path / "go-on").touch()

    thread = meanwhile(go_on)
    options = RunOptions(cluster=cluster.address)
    outcome = run_over_scans(WaitAtTheEnd(tmp_path), scans_of(*NAMES), options, on_result=note)
    thread.join()
    assert outcome.failures == ()
    assert done(tmp_path) == NAMES
    assert caplog.text.count("has salsanext 0.0.1") == 1


@pytest.mark.parametrize("which", ["scan", "folder"])
def test_a_folder_that_nodes_do_not_see_is_named(tmp_path, cluster, which, monkeypatch):
    """The folder of a process is another one in each process."""
    here = Path("/proc/self/cwd")
    if not here.exists():
        pytest.skip("no /proc")
    monkeypatch.chdir(tmp_path)
    Path("scan.bin").write_bytes(b"1234")
    Path("out").mkdir()
    Path("out/record.json").write_bytes(b"{}")
    scan = (here if which == "scan" else tmp_path) / "scan.bin"
    out = (here if which == "folder" else tmp_path) / "out"
    caught = refused(
        UsageError,
        f'cluster="{cluster.address}"',
        run_over_scans,
        Write(out),
        [ScanFile(sequence="s", stem="scan", path=scan)],
        RunOptions(cluster=cluster.address),
        writes=[out],
    )
    assert str(scan if which == "scan" else out) in caught.value.problem


def test_a_run_that_is_ended_keeps_what_is_finished_and_leaves_no_worker(tmp_path, cluster):
    task = Write(tmp_path, 0.3)
    options = RunOptions(cluster=cluster.address)
    with closing(attempts_of_cluster(task, scans_of(*NAMES), options, RunFolders())) as attempts:
        next(attempts)
    finished = done(tmp_path)
    assert 0 < len(finished) < len(NAMES)
    time.sleep(1.0)
    assert done(tmp_path) == finished
    outcome = run(Write(tmp_path), scans_of(*NAMES), cluster=cluster.address)
    assert (outcome.skipped, outcome.done) == (len(finished), len(NAMES) - len(finished))
    assert not [*(tmp_path / "s").glob(f".{MARK.get()}*")]


ENDLESS = """
import sys
from pathlib import Path
from worker_runs import run
from worker_tasks import Write, scans_of
names = [f"{number:02d}" for number in range(40)]
run(Write(Path(sys.argv[1]), 0.3), scans_of(*names), cluster=sys.argv[2])
"""


def test_no_worker_outlives_a_main_process_that_is_killed(tmp_path, cluster):
    path = os.pathsep.join(map(str, (TESTS.parent, TESTS / "helpers")))
    command = [sys.executable, "-c", ENDLESS, str(tmp_path), cluster.address]
    with subprocess.Popen(command, env={**os.environ, "PYTHONPATH": path}) as process:
        wait_for(lambda: done(tmp_path))
        process.kill()
    time.sleep(3.0)
    finished = done(tmp_path)
    time.sleep(1.0)
    assert done(tmp_path) == finished
    assert len(finished) < len(NAMES)


def test_a_lost_cluster_is_one_error_that_names_what_is_missing(
    tmp_path, cluster_of_one, monkeypatch
):
    # Ray itself waits for a minute.
    monkeypatch.setenv("RAY_gcs_rpc_server_reconnect_timeout_s", "5")

    def kill():
        wait_for(lambda: done(tmp_path))
        cluster_of_one.remove_node(cluster_of_one.head_node, allow_graceful=False)

    thread = meanwhile(kill)
    with pytest.raises(WorkersLost) as caught:
        run(Write(tmp_path, 0.3), scans_of(*NAMES), cluster=cluster_of_one.address)
    thread.join()
    assert " of 40 scans are missing" in caught.value.problem
    finished = done(tmp_path)
    outcome = run(Write(tmp_path), scans_of(*NAMES))
    assert (outcome.skipped, outcome.done) == (len(finished), len(NAMES) - len(finished))
