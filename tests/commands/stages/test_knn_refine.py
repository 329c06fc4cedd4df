# SPDX-License-Identifier: MIT
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL, files_below, labels_below, refused, write_array, write_weights

from salsanext_cli import KnnParameters, label_space
from salsanext_cli.commands.stages.knn_refine import knn_refine_scans
from salsanext_cli.commands.stages.predict import predict_range_images, predict_scans
from salsanext_cli.commands.stages.project import project_scans
from salsanext_cli.core.errors import NoInputError, OutputError
from salsanext_cli.core.network.card import RiskThreshold
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import save_with_card
from salsanext_cli.runs.fit.threshold_settings import label_settings
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.provenance import Provenance

SPACE = label_space()


@pytest.fixture
def pixels(world):
    """Leave the pixel labels of three scans in the output folder."""
    project_scans(world.data, world.out, sensor=SMALL)
    predict_range_images(world.out, world.out, settings=world.network)
    return world


def test_other_neighbours_are_other_settings(pixels):
    knn_refine_scans(pixels.out)
    assert knn_refine_scans(pixels.out).skipped == 3
    with pytest.raises(OutputError, match=r"knn\.cutoff"):
        knn_refine_scans(pixels.out, knn=KnnParameters(cutoff=float("inf")))


def test_pixel_labels_of_other_weights_are_noticed(pixels, tmp_path):
    knn_refine_scans(pixels.out)
    before = labels_below(pixels.out)
    other = replace(pixels.network, weights=write_weights(tmp_path / "other.safetensors", seed=1))
    overwrite = RunOptions(overwrite=True)
    predict_range_images(pixels.out, pixels.out, settings=other, options=overwrite)
    with pytest.raises(OutputError):
        knn_refine_scans(pixels.out)
    assert knn_refine_scans(pixels.out, options=overwrite).done == 3
    assert labels_below(pixels.out) != before


def test_labels_that_an_earlier_version_refined_have_the_weights_of_no_pixel_labels(pixels):
    knn_refine_scans(pixels.out)
    manifest = Manifest(pixels.out)
    provenance = Provenance(pixels.out)
    assert provenance.weights("predictions") == provenance.weights("pixel_labels") is not None
    record = manifest.record("knn-refine")
    settings = {"labels": "/theirs"} | {k: v for k, v in record.settings.items() if k != "origins"}
    manifest.write(replace(record, settings=settings))
    assert provenance.weights("predictions") is None
    with pytest.raises(OutputError, match="labels was"):
        knn_refine_scans(pixels.out)


def test_rejected_labels_are_not_restored(world, tmp_path):
    network, weights = world.network, tmp_path / "risk.safetensors"
    tuned = label_settings(network, network.load())
    risk = RiskThreshold("least_confidence", 0.5, 0.5, None, 3, ("00",), settings=tuned)
    save_with_card(network.weights, weights, replace(read_card(network.weights), risk=risk))
    network = replace(network, weights=weights)
    predict_scans(world.data, world.out, settings=network, extras=("pixel_labels",), reject="risk")
    before = files_below(world.out)
    refused(OutputError, world.out, knn_refine_scans, world.out)
    assert files_below(world.out) == before


def test_a_folder_without_pixel_labels_is_named_once(world):
    project_scans(world.data, world.out, sensor=SMALL)
    for out in (world.out, world.out / "none"):
        refused(NoInputError, out, knn_refine_scans, out)


@pytest.mark.parametrize(
    ("array", "number"),
    [(np.zeros((16, 64), np.uint8), "16, 64"), (np.full((16, 128), 20, np.uint8), "20")],
)
def test_pixel_labels_that_do_not_fit_are_named(pixels, array, number):
    path = pixels.result("pixel_labels")
    write_array(path, array)
    (failure,) = knn_refine_scans(pixels.out).failures
    assert str(path) in failure.reason
    assert number in failure.reason


def test_another_network_between_project_and_knn_refine(world):
    """Pixel labels may come from any program; space and sensor are then project's and the set's."""
    project_scans(world.data, world.out, sensor=SMALL)
    for sequence, stem in (("00", "000000"), ("08", "000000"), ("08", "000001")):
        write_array(world.result("pixel_labels", sequence, stem), np.full((16, 128), 9, np.uint8))
    assert knn_refine_scans(world.out).done == 3
    assert set(world.labels()) == {40}
