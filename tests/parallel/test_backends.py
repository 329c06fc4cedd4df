# SPDX-License-Identifier: MIT
"""Every backend with real workers: the bytes do not depend on it, and deaths are survived."""

import os
import signal
import socket
import sys
import threading
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import pytest
from scans import files_below, write_sequence
from works import Write, run, scans_of

from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import MissingDependency, UsageError, WorkersLost
from salsanext_cli.parallel import pool
from salsanext_cli.parallel.options import threads_of_workers
from salsanext_cli.parallel.run import RunOptions
from salsanext_cli.stages.predict import predict_scans
from salsanext_cli.stages.uncertainty import uncertainty
from salsanext_cli.uncertainty.method import UncertaintyMethod

TESTS = Path(__file__).parents[1]
HERE = "127.0.0.1"


@pytest.fixture(scope="module")
def dask():
    """Return the options for a real scheduler with two worker processes."""
    config = pytest.importorskip("dask").config
    distributed = pytest.importorskip("distributed")
    with (
        config.set({"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            host=HERE,
            dashboard_address=f"{HERE}:0",
            scheduler_kwargs={"dashboard": False},
            memory_limit=0,
            silence_logs=60,
        ) as cluster,
    ):
        yield {"backend": "dask", "scheduler": cluster.scheduler_address}


@pytest.fixture(scope="module")
def ray():
    """Return the options for a real Ray of two CPUs."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        # Workers of Ray are started anew and know nothing of the path of this process.
        package = TESTS.parent
        old = os.environ.get("PYTHONPATH", "")
        patch.setenv("PYTHONPATH", os.pathsep.join([str(package), str(TESTS), old]))
        cluster = Cluster(
            initialize_head=True, head_node_args={"num_cpus": 2, "include_dashboard": False}
        )
        yield {"backend": "ray", "scheduler": cluster.address}
        cluster.shutdown()


CLUSTERS = [pytest.param(name, marks=pytest.mark.slow) for name in ("dask", "ray")]


@pytest.fixture(params=["loky", "threading", *CLUSTERS])
def workers(request):
    """Return the options for two workers of each kind."""
    if request.param in ("loky", "threading"):
        return {"backend": request.param, "jobs": 2}
    return request.getfixturevalue(request.param)


def everything(data, out, weights, **options):
    """Run the stages that load a network, and return every file they leave."""
    network, batch = NetworkSettings(weights, "cpu"), RunOptions(**options)
    method = UncertaintyMethod(samples=2, aleatoric="none")
    predict_scans(data, out, settings=network, extras=("probabilities",), options=batch)
    uncertainty(data, out, settings=network, method=method, options=batch)
    return files_below(out)


@pytest.fixture(scope="module")
def alone(tmp_path_factory, weights):
    """Return a data set of two sequences, and what one process on one thread makes of it."""
    folder = tmp_path_factory.mktemp("alone")
    write_sequence(folder / "sequences/00", ["000000"], seed=7)
    write_sequence(folder / "sequences/08", ["000000", "000001", "000002"])
    with threads_of_workers(1):
        return folder, everything(folder, folder / "out", weights)


@pytest.fixture
def connected(workers):
    """Stay connected with Ray from stage to stage: it starts workers anew for each connection."""
    with ExitStack() as stack:
        if workers["backend"] == "ray":
            ray = pytest.importorskip("ray")
            stack.enter_context(pool._connected_to_ray(ray, workers["scheduler"]))
        yield workers


def test_the_bytes_do_not_depend_on_who_works(tmp_path, alone, weights, connected, monkeypatch):
    # One thread for each of two workers, whatever the machine.
    monkeypatch.setattr("joblib.cpu_count", lambda: 2)
    data, expected = alone
    assert len(expected) == 4 * (3 + 3) + 3
    assert everything(data, tmp_path / "out", weights, **connected) == expected


def test_failures_are_named_and_the_rest_is_done(tmp_path, workers, monkeypatch):
    """Relative names start where the run was started; who handled SIGTERM still does."""
    monkeypatch.chdir(tmp_path)
    handler = signal.getsignal(signal.SIGTERM)
    outcome = run(Write(Path("out")), scans_of("bad2", "a", "bad1", "b"), **workers)
    assert [failure.reason for failure in outcome.failures] == [
        "/scans/bad1.bin · cut off",
        "/scans/bad2.bin · cut off",
    ]
    assert sorted(path.name for path in Path("out/s").iterdir()) == ["a", "b"]
    assert signal.getsignal(signal.SIGTERM) is handler
    with pytest.raises(ZeroDivisionError, match="a bug of ours"):
        run(Write(tmp_path), scans_of("a", "bug", "b"), **workers)


def test_a_scan_that_kills_its_workers_is_one_error_and_the_next_run_goes_on(tmp_path, workers):
    if workers["backend"] == "threading":
        pytest.skip("a thread that is killed takes the run with it")
    scans = scans_of(*(f"{n:02d}" for n in range(8)), "killed", *(f"{n:02d}" for n in range(8, 15)))
    with pytest.raises(WorkersLost) as caught:
        run(Write(tmp_path), scans, **workers)
    # One of Ray's that still asked for a result would connect again by itself.
    assert "ResultThread" not in {type(thread).__name__ for thread in threading.enumerate()}
    missing = [scan for scan in scans if not (tmp_path / "s" / scan.stem).exists()]
    assert "killed" in {scan.stem for scan in missing}
    named = ", ".join(f"s/{scan.stem}" for scan in missing[:3])
    assert f"; {len(missing)} of 16 scans are missing: {named}" in str(caught.value)
    assert str(caught.value).endswith("run again for the rest")
    again = run(Write(tmp_path, peaceful=True), scans, **workers)
    assert (again.done, again.skipped) == (len(missing), 16 - len(missing))
    assert {path.name for path in (tmp_path / "s").iterdir()} == {scan.stem for scan in scans}


@pytest.mark.parametrize("backend", ["dask", "ray"])
def test_a_cluster_needs_an_address(backend):
    with pytest.raises(UsageError, match=f"^--backend {backend} · no --scheduler · "):
        RunOptions(backend=backend)


def test_a_program_that_has_initialised_ray_needs_no_address(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(is_initialized=lambda: True))
    assert RunOptions(backend="ray").scheduler is None


def free_port():
    with socket.socket() as unused:
        unused.bind((HERE, 0))
        return unused.getsockname()[1]


@pytest.mark.parametrize("backend", ["dask", "ray"])
@pytest.mark.parametrize("address", ["{here}:{port}", "nonsense"])
def test_where_no_cluster_answers(tmp_path, backend, address, monkeypatch):
    pytest.importorskip({"dask": "distributed"}.get(backend, backend))
    monkeypatch.setattr(pool, "CONNECT_TIMEOUT_S", 1)
    address = address.format(here=HERE, port=free_port())
    with pytest.raises(UsageError, match=f"^--scheduler {address} · "):
        run(Write(tmp_path), scans_of("a"), backend=backend, scheduler=address)


@pytest.mark.parametrize(("backend", "package"), [("dask", "distributed"), ("ray", "ray")])
def test_a_missing_package_is_named(tmp_path, backend, package, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingDependency, match=rf"pip install 'salsanext\[{backend}\]'"):
        run(Write(tmp_path), scans_of("a", "b"), backend=backend, scheduler="host:1", jobs=2)
