# SPDX-License-Identifier: MIT
"""Stages with a network adapted to the scans at hand."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from safetensors.torch import load_file
from scans import SMALL, labels_below, replace_points, write_sequence

from salsanext_cli import Scan, load_network, project, read_scan
from salsanext_cli.errors import FormatError, NoInputError, OutputError, WeightsError
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.fitting.batch_norm import PooledStatistics
from salsanext_cli.fitting.scan_fit import ADAPTED_SHARE, network_of_run
from salsanext_cli.formats.kitti import write_bin
from salsanext_cli.network.card import read_card
from salsanext_cli.network.weights import NORM_SUFFIXES
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.options import Shard
from salsanext_cli.parallel.run import RunOptions
from salsanext_cli.results.layout import find_scans
from salsanext_cli.results.stage_records import StageRecords
from salsanext_cli.stages.knn_refine import knn_refine_scans
from salsanext_cli.stages.predict import predict_range_images, predict_scans
from salsanext_cli.stages.project import project_scans
from salsanext_cli.stages.tune import tune
from salsanext_cli.stages.uncertainty import uncertainty
from salsanext_cli.uncertainty.method import UncertaintyMethod

FEW = UncertaintyMethod(samples=2, aleatoric="none")


@pytest.fixture
def adapting(world, narrow_weights):
    """Return the world with a small network to be adapted."""
    return replace(world, network=replace(world.network, weights=narrow_weights, adapt=True))


def run(world, out=None, source=None, **options):
    return predict_scans(source or world.data, out or world.out, network=world.network, **options)


def adapted(out):
    """Return the one adapted weights file in an output folder."""
    (found,) = out.glob("adapted-*.safetensors")
    return found


def test_it_is_what_tune_batchnorm_makes_of_the_scans(adapting, target, tmp_path):
    run(adapting)
    plain = replace(adapting.network, adapt=False)
    tune("batchnorm", adapting.data, target, network=plain, share=ADAPTED_SHARE)
    settings, file = StageRecords(adapting.out).settings("predict"), adapted(adapting.out)
    assert settings["weights"] == fingerprint(adapting.network.path)
    assert settings["adapted"] == fingerprint(file)
    assert f"re-estimated on 3 scans, share {ADAPTED_SHARE:g}" in read_card(file).description
    assert read_card(file).sensor == read_card(adapting.network.path).sensor
    tuned, found = load_file(target), load_file(file)
    before = load_file(adapting.network.path)
    assert tuned.keys() == found.keys()
    for name, values in found.items():
        assert values.equal(tuned[name])
        assert values.equal(before[name]) != name.endswith(NORM_SUFFIXES)
    predict_scans(adapting.data, tmp_path / "o", network=replace(plain, weights=target))
    assert labels_below(tmp_path / "o") == labels_below(adapting.out)
    predict_scans(adapting.data, tmp_path / "plain", network=plain)
    assert labels_below(tmp_path / "plain") != labels_below(adapting.out)


def test_step_by_step_in_shards_and_by_workers_the_bytes_are_the_same(adapting, tmp_path):
    run(adapting)
    steps = tmp_path / "steps"
    project_scans(adapting.data, steps, sensor=SMALL)
    predict_range_images(steps, steps, network=adapting.network)
    knn_refine_scans(steps)
    for number in (2, 1):
        run(adapting, tmp_path / "shards", options=RunOptions(shard=Shard(number, 2)))
    run(adapting, tmp_path / "workers", options=RunOptions(jobs=2, backend="threading"))
    expected = labels_below(adapting.out)
    assert len(expected) == 3
    for other in (steps, tmp_path / "shards", tmp_path / "workers"):
        assert labels_below(other) == expected
        assert adapted(other).name == adapted(adapting.out).name


def test_later_runs_and_stages_take_the_same_statistics(adapting):
    run(adapting, selection=ScanSelection(limit=1))
    before = fingerprint(adapted(adapting.out))
    write_sequence(adapting.data / "sequences/09", ["000000"], seed=99)
    assert run(adapting).done == 3
    uncertainty(adapting.data, adapting.out, network=adapting.network, method=FEW)
    assert StageRecords(adapting.out).settings("uncertainty")["adapted"] == before
    assert fingerprint(adapted(adapting.out)) == before


@pytest.mark.parametrize("before", [False, True])
def test_results_with_and_without_are_not_mixed(adapting, before):
    first, other = (replace(adapting.network, adapt=adapt) for adapt in (before, not before))
    predict_scans(adapting.data, adapting.out, network=first)
    labels = labels_below(adapting.out)
    expected = (
        "adapted was .* and is not set" if before else r"predict\.json · made without --adapt"
    )
    with pytest.raises(OutputError, match=expected):
        predict_scans(adapting.data, adapting.out, network=other)
    expected = "labels made with other weights .* --adapt" if before else "made without --adapt"
    with pytest.raises(OutputError, match=expected):
        uncertainty(adapting.data, adapting.out, network=other, method=FEW)
    assert labels_below(adapting.out) == labels
    assert len(list(adapting.out.glob("adapted-*"))) == before
    anew = RunOptions(overwrite=True)
    assert predict_scans(adapting.data, adapting.out, network=other, options=anew).done == 3
    assert labels_below(adapting.out) != labels


@pytest.mark.parametrize("how", ["removed", "changed"])
def test_statistics_that_are_not_there_any_more(adapting, how):
    run(adapting, selection=ScanSelection(limit=1))
    file = adapted(adapting.out)
    content = file.read_bytes()
    file.unlink()
    if how == "changed":
        file.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    with pytest.raises(OutputError, match="adapted weights of its results were removed or changed"):
        run(adapting)
    anew = RunOptions(overwrite=True)
    if how == "removed":
        assert run(adapting, options=anew).done == 3
    else:
        with pytest.raises(OutputError, match="was changed, or not written by salsanext"):
            run(adapting, options=anew)


def test_shards_that_begin_at_once_adapt_once(adapting, monkeypatch):
    settings, files, added = adapting.network, find_scans(adapting.data), []
    both, found = threading.Barrier(2), []
    add = PooledStatistics.add
    monkeypatch.setattr(
        PooledStatistics, "add", lambda *given: (added.append(given), add(*given))[1]
    )

    def begin():
        network = settings.load()
        both.wait()
        found.append(network_of_run(settings, network, files, adapting.out)[1].engine.sha256)

    shards = [threading.Thread(target=begin) for _ in range(2)]
    for shard in shards:
        shard.start()
    for shard in shards:
        shard.join()
    assert len(added) == 3
    assert found == 2 * [fingerprint(adapted(adapting.out))]


def test_scans_that_get_no_labels_do_not_count(adapting, tmp_path):
    run(adapting)
    write_sequence(adapting.data / "sequences/09", ["0", "1"], count=3)
    scan = read_scan(adapting.scan())
    write_bin(
        adapting.data / "sequences/09/velodyne/0.bin", Scan(1000 * scan.points, scan.intensity)
    )
    replace_points(adapting.data / "sequences/09/velodyne/1.bin", [])
    outcome = run(adapting, tmp_path / "more")
    assert (outcome.done, len(outcome.failures)) == (4, 1)
    assert adapted(tmp_path / "more").name == adapted(adapting.out).name


def test_nothing_to_adapt_to(adapting):
    nothing = replace_points(adapting.scan(), [])
    with pytest.raises(NoInputError, match="--adapt · no point of 1 scan is in view"):
        run(adapting, source=nothing)
    adapting.scan("00").write_bytes(b"cut")
    with pytest.raises(FormatError, match=r"000000\.bin · 3 bytes"):
        run(adapting, source=adapting.scan("00"))
    assert not adapting.out.exists()


def test_networks_that_cannot_be_adapted(adapting, monkeypatch):
    settings, files = adapting.network, find_scans(adapting.data)
    network = settings.load()
    onnx = replace(settings, weights=adapting.data / "m.onnx")
    with pytest.raises(WeightsError, match=r"m\.onnx · an ONNX model"):
        network_of_run(onnx, network, files, adapting.out)
    monkeypatch.setattr("salsanext_cli.fitting.batch_norm.norms", lambda _: {})
    with pytest.raises(WeightsError, match=r"random\.safetensors · its network has no batch norm"):
        network_of_run(settings, network, files, adapting.out)
    assert not adapting.out.exists()


def test_openvino_computes_the_adapted_network(adapting):
    settings, files = replace(adapting.network, engine="openvino"), find_scans(adapting.data)
    _, network = network_of_run(settings, settings.load(), files, adapting.out)
    image = project(read_scan(files[0].path), SMALL)
    expected = load_network(adapted(adapting.out), "cpu", engine="torch").probabilities(image)
    np.testing.assert_allclose(network.probabilities(image), expected, atol=1e-4)
