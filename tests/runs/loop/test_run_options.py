# SPDX-License-Identifier: MIT
"""GPUs and shards of workers; no GPU is needed, since their number is an argument."""

import subprocess
import sys
from collections import Counter
from itertools import pairwise
from multiprocessing import current_process
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import refused

from salsanext_cli.commands.line.option_names import CommandLine
from salsanext_cli.commands.line.shard_option import shard_of_slurm, shard_of_text
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.wording import spelled
from salsanext_cli.runs.loop.network_task import device_of_worker
from salsanext_cli.runs.loop.pool import MAX_CHUNK_SCANS, MIN_CHUNKS_PER_WORKER, chunks
from salsanext_cli.runs.loop.run_options import Shard, cores, worker_count
from salsanext_cli.runs.results.paths import ScanFile


def test_jobs():
    assert worker_count(3) == 3
    assert worker_count(-1) == cores() >= 1


ASK = """
import sys
from multiprocessing import current_process
from pathlib import Path
from salsanext_cli.runs.loop import network_task
current_process().name = "LokyProcess-1"
network_task._folder_of_numbers = lambda: Path(sys.argv[1])
print(*(network_task.device_of_worker(name, 2) for name in ("cuda", "auto")), flush=True)
sys.stdin.read()
"""


def test_worker_processes_take_different_gpus_and_a_killed_one_leaves_it(tmp_path):
    def started():
        return subprocess.Popen(
            [sys.executable, "-c", ASK, str(tmp_path / "numbers")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    # Each reads until it is closed, when the system releases its lock.
    with started() as first, started() as second, started() as third:
        found = [process.stdout.readline().split() for process in (first, second, third)]
        assert sorted(found) == [["cuda:0"] * 2] * 2 + [["cuda:1"] * 2]
        odd = (first, second, third)[found.index(["cuda:1"] * 2)]
        odd.kill()
        odd.wait()
        with started() as fourth:
            assert fourth.stdout.readline() == "cuda:1 cuda:1\n"


def test_a_device_that_was_named_or_is_alone_or_of_no_worker_stays(monkeypatch):
    assert device_of_worker("auto", 4) == "auto"
    monkeypatch.setattr(current_process(), "name", "LokyProcess-1")
    for device, count in (("cpu", 4), ("cuda:3", 4), ("auto", 1), ("cuda", 0)):
        assert device_of_worker(device, count) == device


COUNTS = st.integers(1, 9)
NAMES = st.sets(st.tuples(st.sampled_from(["00", "08", "a"]), st.integers(0, 99)), max_size=40)


def scans_of(names):
    return [ScanFile(s, f"{n:06d}", Path(f"/{s}/{n}.bin")) for s, n in sorted(names)]


def every(count):
    return [Shard(number, count) for number in range(1, count + 1)]


@given(NAMES, COUNTS, st.randoms(use_true_random=False))
def test_all_shards_have_every_scan_once_whatever_the_order(names, count, draw):
    scans = scans_of(names)
    found: Counter[ScanFile] = Counter()
    sizes = []
    for shard in every(count):
        shuffled = draw.sample(scans, len(scans))
        mine = shard.of(shuffled)
        found.update(mine)
        sizes.append(len(mine))
    assert found == Counter(scans)
    assert max(sizes) - min(sizes) <= 1


def test_shards_are_read():
    assert shard_of_text("08/08") == Shard(8, 8)
    for text in ("", "0/4", "5/4", "1/0", "-1/4", "1/4/2", "1 / 4", "²/4", "1/" + 99 * "9"):
        with spelled(CommandLine()):
            refused(UsageError, "--shard", shard_of_text, text)
    refused(UsageError, "shard", Shard, 5, 4)


def slurm(number, least, count, **more):
    names = {"ID": number, "MIN": least, "COUNT": count, **more}
    return {f"SLURM_ARRAY_TASK_{name}": str(value) for name, value in names.items()}


def test_arrays_of_slurm_are_shards_or_refused():
    for environment, shard in (
        (slurm(7, 0, 8, STEP=1), Shard(8, 8)),
        (slurm(1, 1, 8), Shard(1, 8)),
        (slurm(14, 10, 3, STEP=2), Shard(3, 3)),
        (slurm(5, 5, 1), Shard(1, 1)),
        ({}, None),
        ({"SLURM_ARRAY_TASK_ID": "1"}, None),
    ):
        assert shard_of_slurm(environment) == shard
    for environment in (
        *(slurm(7, 1, 3, STEP=1), slurm(0, 1, 3), slurm(3, 0, 4, STEP=2), slurm("x", 0, 4)),
        *(slurm(1, 0, 4, STEP="x"), slurm(1, 0, 4, STEP="")),
    ):
        with pytest.raises(UsageError) as caught:
            shard_of_slurm(environment)
        assert caught.value.subject.startswith("SLURM_ARRAY_TASK_ID=")


@given(st.lists(st.integers(0, 120), max_size=6), st.integers(1, 40))
def test_chunks_hold_every_scan_in_order_and_are_alike_within_a_sequence(lengths, workers):
    scans = scans_of((f"{s:02d}", n) for s, length in enumerate(lengths) for n in range(length))
    found = chunks(scans, workers)
    assert [scan for chunk in found for scan in chunk] == scans
    assert len(found) >= min(len(scans), MIN_CHUNKS_PER_WORKER * workers)
    for chunk in found:
        assert len({scan.sequence for scan in chunk}) == 1
        assert 1 <= len(chunk) <= MAX_CHUNK_SCANS
    for one, other in pairwise(found):
        assert one[0].sequence != other[0].sequence or abs(len(one) - len(other)) <= 1
