# SPDX-License-Identifier: MIT
import json
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL, files_below, labels_below, replace_points, write_weights
from shallow_network import shallow  # noqa: F401

from salsanext_cli import knn_refine, label_space, project, read_scan, sample
from salsanext_cli.commands.stages.knn_refine import knn_refine_scans
from salsanext_cli.commands.stages.predict import predict_range_images, predict_scans
from salsanext_cli.commands.stages.project import project_scans
from salsanext_cli.commands.stages.uncertainty import uncertainty
from salsanext_cli.core.errors import OutputError, UsageError, WeightsError
from salsanext_cli.core.uncertainty.aleatoric import aleatoric, noise_variance
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.core.uncertainty.monte_carlo import scan_seed
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.scans.scan_selection import ScanSelection

KINDS = UncertaintyMethod().kinds
NAN, INF = float("nan"), float("inf")
FOLDERS = [f"uncertainty/{kind}" for kind in KINDS]


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Return shallow weights that are confident, with labels of several classes."""
    return write_weights(tmp_path_factory.mktemp("shallow") / "random.safetensors", seed=9)


@pytest.fixture
def world(world):
    """Return the world with the sensor of its scans: nothing here depends on a fit."""
    return world.unfitted()


def run(world, source=None, out=None, *, options=RunOptions(), **how):
    given = {"settings": world.network, "method": UncertaintyMethod(**{"samples": 3} | how)}
    return uncertainty(source or world.data, out or world.out, options=options, **given)


def test_the_files_hold_what_sampling_gives(on_openvino):
    world = on_openvino
    assert run(world, seed=4).done == 3
    image = project(read_scan(world.scan("08", "000001")), SMALL)
    seed = scan_seed(4, "08", "000001")
    sampled = sample(world.network.load(), image, samples=3, seed=seed)
    noise = noise_variance(world.network.load(), image, seed).mean(axis=0)
    expected = replace(sampled.uncertainty, aleatoric=noise)
    for kind in KINDS:
        values = np.load(world.result(f"uncertainty/{kind}", "08", "000001"))
        of_pixels = getattr(expected, kind)
        assert values.dtype == np.float32
        np.testing.assert_array_equal(values, of_pixels.ravel()[image.pixel_of_point])
        assert len(np.unique(values)) > 100
    assert (noise > 0).all()
    labels = label_space().to_raw(knn_refine(image, sampled.probabilities.argmax(axis=0)))
    np.testing.assert_array_equal(world.labels("08", "000001"), labels)


def test_the_same_whatever_the_order_and_company(world, tmp_path):
    run(world)
    alone = tmp_path / "alone"
    run(world, world.scan("08", "000001"), alone)
    found = {n: c for n, c in files_below(alone).items() if n.endswith((".npy", ".label"))}
    assert found.items() <= files_below(world.out).items()
    assert len(found) == len(KINDS) + 1
    with pytest.raises(OutputError) as caught:
        run(world, samples=4)
    assert "samples was 3 and is 4" in caught.value.problem


def test_predict_does_not_replace_labels_of_the_mean_unasked(world):
    run(world)
    with pytest.raises(OutputError):
        predict_scans(world.data, world.out, settings=world.network)
    overwrite = RunOptions(overwrite=True)
    predict_scans(world.data, world.out, settings=world.network, options=overwrite)
    before = labels_below(world.out)
    assert run(world).skipped == 3
    assert labels_below(world.out) == before
    assert "predictions" not in json.loads((world.out / "uncertainty.json").read_text())["writes"]


def test_points_without_a_measurement_are_unlabelled_and_have_no_uncertainty(world):
    table = np.float32([(0, 0, 0), (NAN, 1, 1), (5, 0, 0), (INF, 0, 0)])
    assert run(world, replace_points(world.scan(), table)).done == 1
    nowhere = ~np.isfinite(table).all(axis=1) | ~table.any(axis=1)
    for folder in FOLDERS:
        np.testing.assert_array_equal(np.isnan(np.load(world.result(folder))), nowhere)
    assert not world.labels()[nowhere].any()


def test_no_dropout_is_refused_and_so_is_unknown_noise_unless_it_does_not_matter(world, tmp_path):
    weights = write_weights(tmp_path / "w.safetensors", dropout=0.0)
    certain = replace(world, network=NetworkSettings(weights, "cpu", engine="torch"))
    with pytest.raises(WeightsError):
        run(certain)
    assert not world.out.exists()
    seen = replace(SMALL, range_noise=None)
    silent = replace(world, network=replace(world.network, sensor=seen))
    with pytest.raises(UsageError) as caught:
        run(silent)
    assert "with sensor" in caught.value.hint
    assert not world.out.exists()
    assert run(silent, aleatoric="none").done == 3


def test_results_of_an_earlier_method_are_not_mixed_with_those_of_sampling(world):
    run(world)
    record = world.out / "uncertainty.json"
    record.write_text(record.read_text().replace('"sampling"', '"analytic"'))
    with pytest.raises(OutputError) as caught:
        run(world)
    assert '"analytic"' in caught.value.problem


def test_the_paper_s_aleatoric_is_assumed_density_filtering(world):
    run(world, aleatoric="paper")
    image = project(read_scan(world.scan("08", "000001")), SMALL)
    noise = aleatoric(world.network.load(), image).mean(axis=0).ravel()
    values = np.load(world.result("uncertainty/aleatoric", "08", "000001"))
    np.testing.assert_array_equal(values, noise[image.pixel_of_point])


def test_without_aleatoric_there_is_no_total(world):
    run(world, aleatoric="none")
    found = {path.parent.name for path in world.out.rglob("*.npy")}
    assert found == {"epistemic", "entropy", "mutual_information"}
    run(world, options=RunOptions(overwrite=True))
    for folder in FOLDERS:
        assert world.result(folder).exists()


def test_labels_made_step_by_step_remember_their_weights(world, tmp_path):
    file = write_weights(tmp_path / "other.safetensors", seed=1)
    other = NetworkSettings(file, "cpu", engine="torch")
    project_scans(world.data, world.out, sensor=SMALL)
    predict_range_images(world.out, world.out, settings=other)
    knn_refine_scans(world.out)
    recorded = Provenance(world.out).recorded_settings(ScanSelection(), None)
    assert recorded["weights"] == fingerprint(other.weights)
    with pytest.raises(OutputError) as caught:
        run(world)
    assert "weights" in caught.value.problem
