# SPDX-License-Identifier: MIT
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL, files_below, labels_below, refused, write_array, write_weights

from salsanext_cli import KnnParameters, knn_refine, label_space, project, read_labels, read_scan
from salsanext_cli.errors import NoInputError, OutputError, UsageError
from salsanext_cli.fitting.sensor_fit import labels_depend_on
from salsanext_cli.formats.kitti import write_labels
from salsanext_cli.geometry.projection import pixels_from_points
from salsanext_cli.network.card import RiskThreshold, read_card
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.parallel.run import RunOptions
from salsanext_cli.stages.knn_refine import knn_refine_scans
from salsanext_cli.stages.predict import predict_range_images, predict_scans
from salsanext_cli.stages.project import project_scans

SPACE = label_space()


@pytest.fixture
def pixels(world):
    """Leave the pixel labels of three scans in the output folder."""
    project_scans(world.data, world.out, sensor=SMALL)
    predict_range_images(world.out, world.out, settings=world.network)
    return world


@pytest.fixture
def truth(world):
    """Return a folder of point labels of another program, in the layout of the benchmark."""
    folder = world.out.with_name("another program's")
    for sequence in ("00", "08"):
        source = world.data / "sequences" / sequence / "labels"
        shutil.copytree(source, folder / "sequences" / sequence / "predictions")
    return folder


def refine(world, labels, **options):
    return knn_refine_scans(world.out, labels=labels, dataset=world.data, sensor=SMALL, **options)


def expected(world, sequence, stem):
    image = project(read_scan(world.scan(sequence, stem)), SMALL)
    raw = read_labels(world.data / f"sequences/{sequence}/labels/{stem}.label")
    pixels = pixels_from_points(SPACE.to_train(raw), image.point_of_pixel)
    return SPACE.to_raw(knn_refine(image, pixels))


def test_labels_of_other_programs_are_refined(world, truth):
    assert refine(world, truth).done == 3
    for sequence, stem in (("00", "000000"), ("08", "000000"), ("08", "000001")):
        np.testing.assert_array_equal(world.labels(sequence, stem), expected(world, sequence, stem))
    plain = truth / "sequences/08/predictions"
    assert (world.labels() != read_labels(plain / "000000.label")).any()
    of_one, out = world.data / "sequences/08", world.out / "plain"
    assert knn_refine_scans(out, labels=plain, dataset=of_one, sensor=SMALL).done == 2


def test_labels_that_do_not_fit_or_are_missing_fail_that_scan(world, truth):
    path = truth / "sequences/08/predictions/000000.label"
    write_labels(path, read_labels(path)[:-1])
    other = truth / "sequences/08/predictions/000001.label"
    write_labels(other, np.full(1500, 77, np.uint32))
    outcome = refine(world, truth)
    assert outcome.done == 1
    assert [failure.scan.stem for failure in outcome.failures] == ["000000", "000001"]
    for failure, number in zip(outcome.failures, ("1,499", "77"), strict=True):
        assert number in failure.reason


def test_labels_are_not_refined_onto_themselves(world, truth):
    """Overwriting would remove what is to be read."""
    predict_scans(world.data, world.out, settings=world.network)
    before = files_below(world.out)
    for inside in (world.out, world.out / "sequences/08/predictions"):
        with refused(UsageError, "--labels"):
            knn_refine_scans(world.out, labels=inside, options=RunOptions(overwrite=True))
    assert files_below(world.out) == before


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


def test_rejected_labels_are_not_restored(world, tmp_path):
    network, weights = world.network, tmp_path / "risk.safetensors"
    tuned = labels_depend_on(network, network.load())
    risk = RiskThreshold("least_confidence", 0.5, 0.5, None, 3, ("00",), settings=tuned)
    save_with_card(network.weights, weights, replace(read_card(network.weights), risk=risk))
    network = replace(network, weights=weights)
    predict_scans(world.data, world.out, settings=network, extras=("pixel_labels",), reject="risk")
    before = files_below(world.out)
    refused(OutputError, world.out, knn_refine_scans, world.out)
    for labels in (world.out, world.out / "sequences/08/predictions"):
        with refused(OutputError, labels):
            knn_refine_scans(tmp_path / "refined", labels=labels, dataset=world.data)
    assert files_below(world.out) == before
    assert not (tmp_path / "refined").exists()


def test_a_folder_without_labels_or_pixel_labels_is_named_once(world, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    for name in ("typo", "file", "empty"):
        refused(NoInputError, tmp_path / name, refine, world, tmp_path / name)
    assert not world.out.exists()
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
