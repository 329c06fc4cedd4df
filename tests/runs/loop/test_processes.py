# SPDX-License-Identifier: MIT
"""Real workers: the bytes do not depend on their number, and deaths are survived."""

import signal
from pathlib import Path

import pytest
from devices import threads
from scans import files_below, salsanext_of, write_sequence, write_weights
from shallow_network import SHALLOW
from worker_runs import run
from worker_tasks import Write, scans_of, threads_of_process

from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.commands.stages.uncertainty import uncertainty
from salsanext_cli.core.errors import WorkersLost
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.runs.loop.finished_attempts import append_attempt
from salsanext_cli.runs.loop.job import Attempt
from salsanext_cli.runs.loop.run import RunOptions, run_over_scans
from salsanext_cli.runs.network_settings import NetworkSettings


def predicted(data, out, weights, **options):
    """Run `predict`, and return every file it leaves."""
    network, batch = NetworkSettings(weights, "cpu"), RunOptions(**options)
    predict_scans(data, out, settings=network, extras=("probabilities",), options=batch)
    return files_below(out)


def everything(data, out, weights, **options):
    """Run the stages that load a network, and return every file they leave."""
    predicted(data, out, weights, **options)
    network, batch = NetworkSettings(weights, "cpu"), RunOptions(**options)
    method = UncertaintyMethod(samples=2, aleatoric="none")
    uncertainty(data, out, settings=network, method=method, options=batch)
    return files_below(out)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Return a data set of two sequences."""
    folder = tmp_path_factory.mktemp("data")
    write_sequence(folder / "sequences/00", ["000000"], seed=7)
    write_sequence(folder / "sequences/08", ["000000", "000001", "000002"])
    return folder


@pytest.fixture
def two_cores(monkeypatch):
    """Have one thread for each of two workers, whatever the machine."""
    monkeypatch.setenv("LOKY_MAX_CPU_COUNT", "2")


@pytest.fixture
def copies_in_process(workers_in_process, tmp_path):
    """Have copies in this process as workers, and return weights of few levels and channels."""
    with salsanext_of(**SHALLOW):
        yield write_weights(tmp_path / "shallow.safetensors")


@pytest.fixture
def processes(two_cores, weights):
    """Have processes as workers, and return weights that these can read."""
    return weights


@pytest.mark.usefixtures("two_cores")
def test_cores_are_divided_among_the_workers():
    """The next test has the same processes, which then have imported torch."""
    seen = []
    with threads(2):
        run_over_scans(
            threads_of_process, scans_of("a", "b"), RunOptions(jobs=2), on_result=seen.append
        )
    assert seen == [(1, 1)] * 2


def test_the_bytes_of_predict_do_not_depend_on_who_works(tmp_path, data, processes):
    with threads(1):
        expected = predicted(data, tmp_path / "alone", processes)
    found = predicted(data, tmp_path / "out", processes, jobs=2)
    assert len(found) == 4 * 3 + 2
    assert found == expected


@pytest.mark.parametrize(
    "workers", ["copies_in_process", pytest.param("processes", marks=pytest.mark.slow)]
)
def test_the_bytes_do_not_depend_on_who_works(tmp_path, data, workers, request):
    """Copies in this process take the last scans first; processes of their own are slow."""
    weights = request.getfixturevalue(workers)
    with threads(1):
        expected = everything(data, tmp_path / "alone", weights)
    assert len(expected) == 4 * (3 + 3) + 3
    assert everything(data, tmp_path / "out", weights, jobs=2) == expected


def test_failures_are_named_and_the_rest_is_done(tmp_path, monkeypatch):
    """Relative names start where the run was started; who handled SIGTERM still does."""
    monkeypatch.chdir(tmp_path)
    handler = signal.getsignal(signal.SIGTERM)
    outcome = run(Write(Path("out")), scans_of("bad2", "a", "bad1", "b"), jobs=2)
    assert [failure.reason for failure in outcome.failures] == [
        "/scans/bad1.bin: cut off",
        "/scans/bad2.bin: cut off",
    ]
    assert sorted(path.name for path in Path("out/s").iterdir()) == ["a", "b"]
    assert signal.getsignal(signal.SIGTERM) is handler
    with pytest.raises(ZeroDivisionError, match="a bug of ours"):
        run(Write(tmp_path), scans_of("a", "bug", "b"), jobs=2)


def test_a_scan_that_kills_its_workers_is_one_error_and_the_next_run_goes_on(tmp_path):
    scans = scans_of(*(f"{n:02d}" for n in range(8)), "killed", *(f"{n:02d}" for n in range(8, 15)))
    with pytest.raises(WorkersLost) as caught:
        run(Write(tmp_path), scans, jobs=2)
    missing = [scan for scan in scans if not (tmp_path / "s" / scan.stem).exists()]
    assert "killed" in {scan.stem for scan in missing}
    named = ", ".join(f"s/{scan.stem}" for scan in missing[:3])
    assert f" {len(missing)} of 16 scans are missing: {named}" in caught.value.problem
    assert caught.value.subject == "jobs 2"
    again = run(Write(tmp_path, peaceful=True), scans, jobs=2)
    assert (again.done, again.skipped) == (len(missing), 16 - len(missing))
    assert {path.name for path in (tmp_path / "s").iterdir()} == {scan.stem for scan in scans}


def test_finished_scans_of_a_killed_chunk_are_reported(tmp_path):
    """The fourth scan of the first chunk of four kills its worker."""
    scans = scans_of("00", "01", "bad", "killed", *(f"{n:02d}" for n in range(4, 32)))
    results, done = [], []
    options = RunOptions(jobs=2, progress=lambda count, _: done.append(count))
    with pytest.raises(WorkersLost) as caught:
        run_over_scans(Write(tmp_path), scans, options, on_result=results.append)
    assert {"00", "01"} <= {*results}
    assert len({*results}) == len(results)
    assert done == [*range(len(done))]
    attempted = done[-1]
    # The failure is one of the reported scans.
    assert attempted == len(results) + 1
    assert f" {32 - attempted} of 32 scans are missing" in caught.value.problem


def test_no_folder_is_left_of_finished_scans(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    seen = []

    def look(_: str) -> None:
        seen.append([*tmp_path.glob("salsanext-*")])

    options = RunOptions(jobs=2)
    run_over_scans(Write(tmp_path / "out"), scans_of("a", "b", "c"), options, on_result=look)
    assert all(len(folders) == 1 for folders in seen)
    assert not [*tmp_path.glob("salsanext-*")]


def test_a_run_needs_no_temporary_folder(tmp_path, monkeypatch):
    """As in a container whose only writable folder is that of the results."""

    def refuse(**_):
        raise FileNotFoundError("no usable temporary directory")

    monkeypatch.setattr("tempfile.gettempdir", refuse)
    outcome = run(Write(tmp_path), scans_of("a", "b"), jobs=2)
    assert outcome.done == 2
    append_attempt(tmp_path / "nowhere" / "0", Attempt(file=scans_of("a")[0], result="a"))
