# SPDX-License-Identifier: MIT
"""Two workers under torchrun, with gloo, beside one worker with twice the batch."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from scans import SMALL, write_sequence
from torch.distributed import is_gloo_available
from two_workers import CASES, batch, learner, share, stepped

import salsanext_cli
from salsanext_cli.errors import TrainingError, UsageError
from salsanext_cli.training.distributed import SINGLE_PROCESS, ProcessGroup, process_group
from salsanext_cli.training.fit import Training

SCRIPT = Path(__file__).with_name("two_workers.py")

gloo = pytest.mark.skipif(not is_gloo_available(), reason="needs gloo")


FOLDERS = (Path(salsanext_cli.__file__).parents[1], Path(__file__).parents[1])
ENVIRONMENT = {"PYTHONPATH": os.pathsep.join(map(str, FOLDERS)), "OMP_NUM_THREADS": "1"}


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


def started(task: object, count: int) -> list[subprocess.Popen[str]]:
    """Start workers as torchrun does, which itself takes seconds."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(free.getsockname()[1])}
    group = {"TORCHELASTIC_RUN_ID": "test", "WORLD_SIZE": str(count)}
    own = os.environ | ENVIRONMENT | address | group
    return [
        subprocess.Popen(
            [sys.executable, str(SCRIPT), str(task)],
            env=own | {"RANK": str(rank)},
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank in range(count)
    ]


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return what two workers computed."""
    path = tmp_path_factory.mktemp("two") / "result.pt"
    workers = started(path, 2)
    try:
        said = [worker.communicate(timeout=200)[1] for worker in workers]
        assert [worker.returncode for worker in workers] == [0, 0], said
    finally:
        for worker in workers:
            worker.kill()
    found: dict[str, Any] = torch.load(path, weights_only=True)
    assert found["size"] == 2
    return found


@gloo
def test_workers_end_with_the_one_that_fails_and_name_it() -> None:
    """The first is busy for longer than the test, the second waits in a collective."""
    workers = started("fail", 3)
    try:
        said = [worker.communicate(timeout=200)[1].splitlines() for worker in workers[::-1]]
    finally:
        for worker in workers:
            worker.kill()
    assert [worker.returncode for worker in workers] == [1, 1, 1]
    assert said[0][-1].endswith("ZeroDivisionError: out of luck")
    for lines in said[1:]:
        (line,) = lines
        assert line.startswith("worker 2 of 3 on ")
        assert line.endswith(": out of luck")


@gloo
@pytest.mark.parametrize("case", CASES)
def test_two_workers_have_the_gradient_of_one_with_twice_the_batch(two, case):
    """And its weights; without batch norm, and of five samples, so that their shares are unlike."""
    exact = {"rtol": 1e-5, "atol": 1e-10}
    near = exact if case != "bfloat16" else {"rtol": 0.02, "atol": 1e-3}
    for name, expected in stepped(SINGLE_PROCESS, case).items():
        torch.testing.assert_close(two[case][name], expected, **near)


@gloo
def test_batch_norm_on_cpus_is_each_workers_own_and_validated_is_the_main_ones(two):
    images, truth = (share(each, ProcessGroup(0, 2)) for each in batch())
    alone = learner(SINGLE_PROCESS, norm=True, average=0.5)
    alone.step(images, truth, 5, 1)
    found = two["normed"]
    torch.testing.assert_close(found["own"][0], alone.average.norm.running_mean)
    assert not torch.allclose(found["own"][0], found["own"][1])
    assert torch.equal(found["after"], found["own"][[0, 0]])
    assert torch.equal(found["weight"][0], found["weight"][1])


@gloo
def test_workers_drop_unlike_channels_and_agree_on_the_rest(two: dict[str, Any]) -> None:
    first, second = two["apart"]["dropped"]
    assert not torch.equal(first, second)
    assert two["apart"]["on_main"].tolist() == [10, 10]
    assert two["apart"]["uneven"].tolist() == [[0, 1, 1], [0, 1, 1]]
    assert [bool(each) for each in two["refused"]] == [True, True]


@gloo
@pytest.mark.slow
def test_the_command_line_under_torchrun(tmp_path: Path) -> None:
    """Three samples an epoch, so that the second worker has one less."""
    write_sequence(tmp_path / "data/sequences/00", ["0", "1", "2"], count=600)
    write_sequence(tmp_path / "data/sequences/08", ["0"], count=600)
    sensor, run = tmp_path / "small.toml", tmp_path / "run"
    sensor.write_text(SMALL.to_toml(), "utf-8")
    given = ("train", tmp_path / "data", run, "--recipe", "quick", "--sensor", sensor, "--json")
    given = (*given, "--also", tmp_path / "data", "--set=sensors=fitted")
    short = ("samples_per_epoch=3", "crop_width=32")
    ended = torchrun("-m", "salsanext_cli", *given, *(f"--set={change}" for change in short))
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout)["best"] == str(run / "best.safetensors")
    assert ended.stderr.count("on CPUs batch norm has the statistics of each worker's share") == 1
    assert ended.stderr.count("train: best validation mIoU") == 1
    assert len((run / "log.csv").read_text("utf-8").splitlines()) == 3


def test_workers_go_on_from_one_step_or_not_at_all(tmp_path: Path) -> None:
    """The first worker's folder has a checkpoint after step 6, this one's has none."""

    class Apart(ProcessGroup):
        def on_main(self, work):
            return 6

    single = SimpleNamespace(group=Apart(1, 2))
    samples = SimpleNamespace(plan=SimpleNamespace(steps_per_epoch=4))
    training = Training(tmp_path, single, samples, *[None] * 5)  # type: ignore[arg-type]
    with pytest.raises(TrainingError, match="after step 6, this one after step 0"):
        training.fit()


@gloo
@pytest.mark.slow
def test_what_is_wrong_with_the_data_is_said_once(tmp_path: Path) -> None:
    ended = torchrun("-m", "salsanext_cli", "train", tmp_path / "nowhere", tmp_path, "--json")
    assert ended.returncode != 0
    assert ended.stderr.count("error: ") == 1
    assert len(ended.stdout.splitlines()) == 1


def test_one_gpu_for_several_workers_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "x")
    monkeypatch.setenv("RANK", "0")
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    with pytest.raises(UsageError, match="device cuda:1: one GPU for 2 workers"):  # noqa: SIM117
        with process_group("cuda:1"):
            pass
