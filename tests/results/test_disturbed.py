# SPDX-License-Identifier: MIT
"""Runs while somebody meddles with their files, their folder or the clock."""

import os
import shutil
from collections.abc import Callable
from functools import partial

import pytest
from scans import labels_below, write_sequence, write_weights

from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import OutputError, WeightsError
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.options import KnnParameters
from salsanext_cli.parallel.run import NetworkTask, RunOptions, run_over_scans
from salsanext_cli.results.layout import find_scans
from salsanext_cli.results.output_run import OutputRun
from salsanext_cli.stages.predict import predict_scan, predict_scans


def run(world, meddle: Callable[[], object] = lambda: None, **options):
    """Predict, and meddle after the first scan."""

    def progress(done: int, _: int) -> None:
        if done == 1:
            meddle()

    given = RunOptions(progress=progress, **options)
    return predict_scans(world.data, world.out, settings=world.network, options=given)


def test_a_scan_that_is_deleted(world, tmp_path):
    """It is the fourth: when the first is done, the third may be read already."""
    write_sequence(world.data / "sequences/08", ["000000", "000001", "000002"])
    predict_scans(world.data, tmp_path / "whole", settings=world.network)
    path = world.scan("08", "000002")
    content = path.read_bytes()
    outcome = run(world, path.unlink)
    assert (outcome.done, len(outcome.failures)) == (3, 1)
    assert outcome.failures[0].reason.startswith(f"{path} · cannot be read: no such file")
    path.write_bytes(content)
    assert run(world).done == 1
    assert labels_below(world.out) == labels_below(tmp_path / "whole")


@pytest.mark.slow
def test_workers_that_find_other_weights_label_no_scan(world, tmp_path):
    """As those of a training that goes on: who has not loaded the first ones stops."""
    weights = tmp_path / "w.safetensors"
    shutil.copy(world.network.weights, weights)
    network = NetworkSettings(weights, "cpu").load()
    settings = NetworkSettings(weights, "cpu").resolved(network)
    write_weights(weights, seed=1)
    output = OutputRun(world.out, folders=("predictions",))
    task = NetworkTask(partial(predict_scan, knn=KnnParameters(), output=output), settings, network)
    with pytest.raises(WeightsError, match="was replaced since the run began"):
        run_over_scans(task, find_scans(world.data), RunOptions(jobs=2))
    assert labels_below(world.out) == {}


def test_an_output_folder_that_is_deleted(world, tmp_path):
    """The results that went with it are not taken for done."""
    predict_scans(world.data, tmp_path / "whole", settings=world.network)
    with pytest.raises(OutputError, match=r"was removed or replaced .* run again with --overwrite"):
        run(world, lambda: shutil.rmtree(world.out))
    with pytest.raises(OutputError, match="is a result that no stage recorded"):
        run(world)
    assert run(world, overwrite=True).done == 3
    assert labels_below(world.out) == labels_below(tmp_path / "whole")


def test_a_file_replaced_by_one_of_the_same_size_and_time(tmp_path):
    """As a clock that was set back, or a copy that keeps times, can leave it."""
    digests = []
    for content in (b"one", b"two"):
        (tmp_path / "new").write_bytes(content)
        os.utime(tmp_path / "new", (1, 1))
        (tmp_path / "new").replace(tmp_path / "file")
        digests.append(fingerprint(tmp_path / "file"))
    assert digests[0] != digests[1]
