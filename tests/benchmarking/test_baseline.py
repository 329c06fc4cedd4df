# SPDX-License-Identifier: MIT
"""The baseline of the benchmark and the product compute the same."""

import importlib
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scans import SMALL, make_scan, write_weights

from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.geometry.knn import knn_refine
from salsanext_cli.geometry.projection import project
from salsanext_cli.inference.network import load_network
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.records import RangeImage, Scan
from salsanext_cli.stages.predict import predict_scans
from salsanext_cli.storage.point_files import write_bin
from salsanext_cli.uncertainty.aleatoric import aleatoric

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
ODD = replace(SMALL, height=17, width=120)
"""A size that the network has to pad."""


@pytest.fixture
def plain(monkeypatch):
    """Return the module of the baseline."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("baseline")


@pytest.fixture
def both(plain, weights):
    """Return the network of the product and the baseline, for images of an odd size."""
    baseline = plain.Baseline(weights, sensor=ODD.to_dict())
    return load_network(weights, "cpu", ODD), baseline


def table_of(scan: Scan) -> np.ndarray:
    return np.column_stack((scan.points, scan.intensity))


def with_holes(image: RangeImage) -> np.ndarray:
    """Return the channels as the baseline has them: -1 where a pixel is empty."""
    return np.where(image.channels[0] > 0, image.channels, np.float32(-1))


@pytest.mark.parametrize("out_of_view", ["clamp", "drop"])
@pytest.mark.parametrize("fov_up", [3.0, -2.0])
def test_same_pixels_but_for_rounding(plain, out_of_view, fov_up):
    sensor = replace(SMALL, width=1024, height=64, fov_up=fov_up, out_of_view=out_of_view)
    scan = make_scan(50_000)
    scan.points[:3] = ([0, 0, 0], [np.nan, 1, 1], [np.inf, 1, 1])
    ours = project(scan, sensor)
    seen = plain.seen(table_of(scan), sensor.to_dict())
    assert np.mean(seen != (ours.pixel_of_point >= 0)) <= 1e-3
    assert not seen[:3].any()
    image, pixel, depth = plain.project(table_of(scan)[seen], sensor.to_dict())
    same = pixel == ours.pixel_of_point[seen]
    assert np.mean(~same) <= 1e-3
    np.testing.assert_allclose(depth[same], ours.point_range[seen][same], rtol=1e-6)
    assert np.mean(~np.isclose(image, with_holes(ours), rtol=1e-6).all(0)) <= 1e-3


def test_same_softmax(both):
    network, baseline = both
    image = project(make_scan(), ODD)
    ours = torch.from_numpy(network.logits(image)).softmax(0).numpy()
    assert ours.std(axis=(1, 2)).max() > 0.01
    np.testing.assert_allclose(baseline.probabilities(with_holes(image)), ours, atol=1e-4)


def test_same_moments(both):
    network, baseline = both
    image = project(make_scan(), ODD)
    _, variance = baseline.aleatoric(with_holes(image))
    ours = aleatoric(network, image)
    assert ours.max() > 1e-3
    np.testing.assert_allclose(variance.numpy(), ours, rtol=1e-3, atol=1e-12)


def test_passes_without_noise_are_those_of_plain_dropout(plain, tmp_path):
    """Both networks draw the same masks; the passes' variance and mean are NumPy's."""
    quiet = replace(SMALL, range_noise=0.0, intensity_noise=0.0)
    weights = write_weights(tmp_path / "quiet.safetensors", sensor=quiet)
    baseline = plain.Baseline(weights)
    image = with_holes(project(make_scan(), quiet))
    certain = baseline.probabilities(image)
    torch.manual_seed(1)
    mean, epistemic, noise = baseline.uncertainty(image, passes=3)
    plain.drop(baseline.network)
    torch.manual_seed(1)
    passes = np.stack([baseline.probabilities(image) for _ in range(3)])
    np.testing.assert_allclose(mean, passes.mean(0), atol=1e-5)
    np.testing.assert_allclose(epistemic, passes.var(0).mean(0), atol=1e-5)
    np.testing.assert_allclose(noise, 0, atol=1e-12)
    assert epistemic.max() > 1e-3
    np.testing.assert_allclose(baseline.aleatoric(image)[0], certain, atol=1e-5)


def test_same_neighbours_but_for_the_published_rules(both):
    """The published image has an end, padding that votes, and a class 1 for nobody's vote."""
    _, baseline = both
    scan = make_scan(20_000)
    image = project(scan, SMALL)
    labels = np.random.default_rng(0).integers(0, 20, (SMALL.height, SMALL.width))
    labels[3:10, 20:60] = 0
    ours = knn_refine(image, labels)
    plain = baseline.refine(with_holes(image), labels, image.pixel_of_point, image.point_range)
    v, u = np.divmod(image.pixel_of_point, SMALL.width)
    half = 2
    inner = (v >= half) & (v < SMALL.height - half) & (u >= half) & (u < SMALL.width - half)
    voted = ours > 0
    assert inner.mean() > 0.6
    np.testing.assert_array_equal(plain[inner & voted], ours[inner & voted])
    assert (inner & ~voted).any()
    assert set(plain[inner & ~voted]) == {1}


def test_same_counts(plain):
    truth, predicted = np.random.default_rng(0).integers(0, 20, (2, 10_000)).astype(np.uint8)
    ours = Confusion(20).update(truth, predicted)
    np.testing.assert_array_equal(plain.confusion(truth, predicted, 20), ours.matrix)


def test_the_script_labels_a_scan_as_predict_does(tmp_path, weights):
    """No window of these neighbours reaches an edge of the image, nor is anybody unlabelled."""
    scan = make_scan()
    write_bin(tmp_path / "000000.bin", scan)
    out = tmp_path / "plain.label"
    command = (BENCHMARKS / "baseline.py", tmp_path / "000000.bin", out, "--weights", weights)
    subprocess.run([sys.executable, *map(str, command)], check=True)
    predict_scans(
        tmp_path / "000000.bin", tmp_path / "out", network=NetworkSettings(weights, device="cpu")
    )
    (ours,) = (tmp_path / "out").rglob("*.label")
    image = project(scan, SMALL)
    v, u = np.divmod(image.pixel_of_point, SMALL.width)
    inner = (v >= 2) & (v < SMALL.height - 2) & (u >= 2) & (u < SMALL.width - 2)
    plain, labels = read_labels(out, len(scan)), read_labels(ours, len(scan))
    voted = labels > 0
    assert (inner & voted).mean() > 0.5
    assert np.mean(plain[inner & voted] != labels[inner & voted]) <= 2e-3
