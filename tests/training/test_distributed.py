# SPDX-License-Identifier: MIT
"""Two workers under torchrun, with gloo, beside one worker with twice the batch."""

import json
import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from filelock import FileLock
from scans import SMALL, refused, write_sequence
from torch.distributed import is_gloo_available
from training.forked_workers import ENVIRONMENT, Group, GroupEnd, ends_of
from training.two_workers import CASES, RESULTS, batch, learner, share, stepped

from salsanext_cli.core.errors import TrainingError, UsageError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.training.distributed import (
    SINGLE_PROCESS,
    ProcessGroup,
    agreed_precision,
    process_group,
)
from salsanext_cli.training.fit import Training

TWO = Group(module="training.two_workers", function="write_results", size=2)
FAILING = Group(module="training.failing_workers", function="fail", size=3)
FAILING_ALIKE = Group(module="training.failing_workers", function="fail_alike", size=2)

gloo = pytest.mark.skipif(
    not (is_gloo_available() and hasattr(os, "fork")), reason="needs gloo and fork"
)


def torchrun(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run two workers of one machine."""
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone"]
    return subprocess.run(
        [*command, "--nproc-per-node", "2", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=400,
        check=False,
        env=os.environ | ENVIRONMENT,
    )


@pytest.fixture(scope="module")
def ends(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[GroupEnd]]:
    """Return a folder with the results of two workers, and how these and three others end.

    They run once for all processes that test.
    """
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "workers"
    with FileLock(folder.with_suffix(".lock")):
        record = folder / "ends.json"
        if not record.exists():
            folder.mkdir()
            ends = ends_of(folder, TWO, FAILING)
            record.write_text(json.dumps([asdict(end) for end in ends]), "utf-8")
    return folder, [GroupEnd(**end) for end in json.loads(record.read_text("utf-8"))]


@pytest.fixture(scope="module")
def two(ends: tuple[Path, list[GroupEnd]]) -> dict[str, Any]:
    """Return the results of two workers."""
    folder, (end, _) = ends
    assert end.status == [0, 0], end.messages
    results: dict[str, Any] = torch.load(folder / RESULTS, weights_only=True)
    assert results["size"] == 2
    return results


@gloo
def test_workers_end_with_the_one_that_fails_and_name_it(ends: tuple[Path, list[GroupEnd]]) -> None:
    """The first is busy for longer than the test, the second waits in a collective."""
    _, (_, end) = ends
    assert end.status == [1, 1, 1]
    assert end.messages[2].splitlines()[-1].endswith("ZeroDivisionError: out of luck")
    for message in end.messages[:2]:
        (line,) = message.splitlines()
        assert line.startswith("worker 2 of 3 on ")
        assert line.endswith(": out of luck")


@pytest.mark.slow
@gloo
def test_an_error_of_all_workers_is_reported_by_one(tmp_path: Path) -> None:
    (end,) = ends_of(tmp_path, FAILING_ALIKE)
    assert end.status == [0, 0], end.messages
    assert sorted(message.strip() for message in end.messages) == ["", "data: is empty"]


@gloo
@pytest.mark.parametrize("case", CASES)
def test_two_workers_have_the_gradient_of_one_with_twice_the_batch(two, case):
    """And its weights; without batch norm, and of five samples, so that their shares are unlike."""
    exact = {"rtol": 1e-5, "atol": 1e-10}
    near = exact if case != "bfloat16" else {"rtol": 0.02, "atol": 1e-3}
    for name, expected in stepped(SINGLE_PROCESS, case).items():
        torch.testing.assert_close(two[case][name], expected, **near)


@gloo
def test_on_cpus_batch_norm_differs_by_worker_and_the_main_one_is_validated(two):
    images, truth = (share(each, ProcessGroup(rank=0, size=2)) for each in batch())
    alone = learner(SINGLE_PROCESS, norm=True, average=0.5)
    alone.step(images, truth, 5, 1)
    normed = two["normed"]
    torch.testing.assert_close(normed["own"][0], alone.average.norm.running_mean)
    assert not torch.allclose(normed["own"][0], normed["own"][1])
    assert torch.equal(normed["after"], normed["own"][[0, 0]])
    assert torch.equal(normed["weight"][0], normed["weight"][1])


@gloo
def test_workers_drop_unlike_channels_and_agree_on_the_rest(two: dict[str, Any]) -> None:
    first, second = two["apart"]["dropped"]
    assert not torch.equal(first, second)
    assert two["apart"]["on_main"].tolist() == [10, 10]
    assert two["apart"]["uneven"].tolist() == [[0, 1, 1], [0, 1, 1]]
    assert two["refused"].tolist() == [1, 1]


@gloo
@pytest.mark.slow
@pytest.mark.parametrize("samples", ["workers", "device"])
def test_the_command_line_under_torchrun(tmp_path: Path, samples: str) -> None:
    """Three samples an epoch, so that the second worker has one less; and fewer scans."""
    write_sequence(tmp_path / "data/sequences/00", ["0", "1", "2"], count=600)
    write_sequence(tmp_path / "data/sequences/08", ["0"], count=600)
    sensor, run = tmp_path / "small.toml", tmp_path / "run"
    sensor.write_text(SMALL.to_toml(), "utf-8")
    given = ("train", tmp_path / "data", run, "--recipe", "quick", "--sensor", sensor, "--json")
    given = (*given, "--also", tmp_path / "data", "--set=sensors=fitted", "--samples", samples)
    short = ("samples_per_epoch=3", "crop_width=32")
    ended = torchrun("-m", "salsanext_cli", *given, *(f"--set={change}" for change in short))
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout)["best"] == str(run / "best.safetensors")
    lines = ended.stderr.splitlines()
    assert sum("batch norm" in line for line in lines) == 1
    assert sum(line.startswith("train: best") for line in lines) == 1
    assert sum("which also makes the samples" in line for line in lines) == (samples == "device")
    assert len((run / "log.csv").read_text("utf-8").splitlines()) == 3


def test_workers_resume_from_the_same_step_or_not_at_all(tmp_path: Path) -> None:
    """The first worker's folder has a checkpoint after step 6, this one's has none."""

    class Apart(ProcessGroup):
        def on_main(self, work):
            return 6

    single = SimpleNamespace(group=Apart(rank=1, size=2))
    plan = SimpleNamespace(steps_per_epoch=4)
    training = Training(
        run=tmp_path,
        learner=single,
        batches=SimpleNamespace(samples=SimpleNamespace(plan=plan)),
        validation=None,
        card=None,
        report=None,
    )
    refused(TrainingError, tmp_path, training.fit)


@gloo
@pytest.mark.slow
@pytest.mark.parametrize("wrong", [(), ("--set", "batch=1")])
def test_an_error_in_data_or_settings_is_printed_once(wrong: tuple[str], tmp_path: Path) -> None:
    command = ("-m", "salsanext_cli", "train", tmp_path / "nowhere", tmp_path, "--json")
    done = torchrun(*command, *wrong)
    assert done.returncode != 0
    assert done.stderr.count("error: ") == 1
    assert len(done.stdout.splitlines()) == 1


def test_one_gpu_for_several_workers_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "x")
    monkeypatch.setenv("RANK", "0")
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    with refused(UsageError, "device cuda:1"), process_group("cuda:1"):
        pass


class TwoTypes(ProcessGroup):
    """Two workers, the other of which computes in another number type."""

    def gather(self, tensor: torch.Tensor, lengths: Any = None) -> list[torch.Tensor]:
        return [tensor, tensor + 1]


def test_every_training_prints_once_that_its_workers_use_float32(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(NOTICE)
    for _ in range(2):
        group = TwoTypes(rank=0, size=2)
        for _ in range(2):
            assert agreed_precision("float32", "cpu", group) == "float32"
    assert len(caplog.messages) == 2
    agreed_precision("float32", "cpu", TwoTypes(rank=1, size=2))
    assert len(caplog.messages) == 2
