# SPDX-License-Identifier: MIT
"""GPUs and shards of workers; no GPU is needed, since their number is an argument."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from numbered_scans import scans_of
from scans import refused

from salsanext_cli.commands.line.options.option_names import CommandLine
from salsanext_cli.commands.line.values.jobs_option import typed_jobs
from salsanext_cli.commands.line.values.shard_option import (
    shard_of_kubernetes,
    shard_of_slurm,
    shard_of_text,
    typed_shard,
)
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.wording import spelled
from salsanext_cli.runs.loop.run_options import RunOptions, Shard
from salsanext_cli.runs.scans.scan_file import ScanFile

COUNTS = st.integers(1, 9)
NAMES = st.sets(st.tuples(st.sampled_from(["00", "08", "a"]), st.integers(0, 99)), max_size=40)


def every(count):
    return [Shard(number, count) for number in range(1, count + 1)]


@given(NAMES, COUNTS, st.randoms(use_true_random=False))
def test_all_shards_have_every_scan_once_whatever_the_order(names, count, draw):
    scans = scans_of(names)
    found: Counter[ScanFile] = Counter()
    sizes = []
    for shard in every(count):
        shuffled = draw.sample(scans, len(scans))
        mine = shard.select(shuffled)
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


@pytest.mark.parametrize(("text", "jobs"), [(None, None), ("auto", None), ("4", 4), ("-1", -1)])
def test_jobs_are_read(text, jobs):
    assert typed_jobs(text) == jobs


def test_a_run_begins_with_one_worker_unless_more_are_requested():
    assert RunOptions(jobs=None).workers() == 1
    assert RunOptions(jobs=4).workers() == 4
    for text in ("", "many", "1.5"):
        refused(UsageError, "--jobs", typed_jobs, text)
    with spelled(CommandLine()):
        refused(UsageError, "--jobs", RunOptions, jobs=0)


def kubernetes(index, completions):
    return {"JOB_COMPLETION_INDEX": str(index), "JOB_COMPLETIONS": str(completions)}


def test_pods_of_an_indexed_job_are_shards_or_refused():
    assert shard_of_kubernetes(kubernetes(0, 8)) == Shard(1, 8)
    assert shard_of_kubernetes(kubernetes(7, 8)) == Shard(8, 8)
    for variables in ({}, {"JOB_COMPLETION_INDEX": "3"}, {"JOB_COMPLETIONS": "3"}):
        assert shard_of_kubernetes(variables) is None
    for index, count in ((8, 8), (0, 0), (-1, 8), ("x", 8), (0, ""), ("²", 8)):
        refused(
            UsageError,
            f"JOB_COMPLETION_INDEX={index}",
            shard_of_kubernetes,
            kubernetes(index, count),
        )


def test_a_task_of_a_cluster_takes_its_shard_unless_one_is_typed(monkeypatch):
    for name in ("SLURM_ARRAY_TASK_ID", "JOB_COMPLETION_INDEX"):
        monkeypatch.delenv(name, raising=False)
    assert typed_shard(None) == Shard()
    for name, value in kubernetes(2, 4).items():
        monkeypatch.setenv(name, value)
    assert typed_shard(None) == Shard(3, 4)
    assert typed_shard("1/1") == Shard()
    for name, value in slurm(1, 1, 8).items():
        monkeypatch.setenv(name, value)
    assert typed_shard(None) == Shard(1, 8)


def test_workers_are_processes_or_of_a_cluster():
    assert RunOptions(cluster="auto").jobs == 1
    refused(UsageError, "jobs and cluster", RunOptions, jobs=2, cluster="auto")
