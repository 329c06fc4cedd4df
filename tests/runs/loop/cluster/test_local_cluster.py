# SPDX-License-Identifier: MIT
"""One run on a real cluster of two nodes, of which a worker is killed meanwhile."""

import os
import signal
import time
from pathlib import Path

import pytest
from scans import files_below, write_sequence

from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings

MAX_WAIT_S = 60.0  # For a process of a worker, on a machine with much other work
SCANS = [f"{number:06d}" for number in range(24)]


def titles_of_children(parent: int) -> dict[int, str]:
    """Return the titles of the processes that a process has started, by their ids."""
    titles = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            # The name before it, in parentheses, may contain spaces.
            parent_of_it = (folder / "stat").read_text().rpartition(")")[2].split()[1]
            title = (folder / "cmdline").read_bytes().partition(b"\0")[0].decode().strip()
        except OSError:
            continue  # It has ended.
        if int(parent_of_it) == parent:
            titles[int(folder.name)] = title
    return titles


class KillAtTheFirstResult:
    """Progress of a run that kills a worker with an open task at the first result."""

    def __init__(self, nodes) -> None:
        self.nodes = [node.all_processes["raylet"][0].process.pid for node in nodes]
        self.killed = 0

    def __call__(self, attempted: int, scans: int) -> None:
        if attempted and not self.killed:
            self.killed = self.working()
            os.kill(self.killed, signal.SIGKILL)

    def working(self) -> int:
        """Return the id of a worker that has opened the task: one has sent a result."""
        end = time.monotonic() + MAX_WAIT_S
        while True:
            assert time.monotonic() < end
            for node in self.nodes:
                for process, title in titles_of_children(node).items():
                    if title in ("ray::NodeWorker", "ray::NodeWorker.attempt"):
                        return process
            time.sleep(0.01)


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc")
def test_labels_of_two_nodes_are_those_of_one_process_although_a_worker_is_killed(
    tmp_path, full_weights, two_nodes, caplog
):
    write_sequence(tmp_path / "sequences/08", SCANS, labels=False)
    settings = NetworkSettings(full_weights, "cpu", engine="openvino")
    kill = KillAtTheFirstResult(two_nodes.list_all_nodes())
    options = RunOptions(cluster=two_nodes.address, progress=kill)
    predict_scans(tmp_path, tmp_path / "alone", settings=settings)
    outcome = predict_scans(tmp_path, tmp_path / "nodes", settings=settings, options=options)
    assert kill.killed
    assert "a worker ended" in caplog.text
    assert (outcome.done, outcome.failures) == (len(SCANS), ())
    assert files_below(tmp_path / "nodes") == files_below(tmp_path / "alone")
