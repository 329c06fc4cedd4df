# SPDX-License-Identifier: MIT
from dataclasses import replace

import numpy as np
import pytest
import torch
from scans import SMALL, make_scan, write_sequence

from salsanext_cli import knn_refine, load_network, project, read_scan, sample
from salsanext_cli.errors import FormatError
from salsanext_cli.formats.kitti import write_bin
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.uncertainty.scan_description import describe_scan, label_sampled, pixel_features

PASSES = {"samples": 3, "seed": 4}


@pytest.fixture
def network(request, weights):
    return load_network(weights, "cpu", engine=getattr(request, "param", "torch"))


@pytest.fixture
def file(tmp_path) -> ScanFile:
    folder = write_sequence(tmp_path / "00", ["000007"])
    return ScanFile("00", "000007", folder / "velodyne/000007.bin")


@pytest.mark.parametrize("network", ["torch", "openvino"], indirect=True)
def test_the_features_are_what_the_logits_are_made_of(network):
    image = project(make_scan(), SMALL)
    features = pixel_features(network, image)
    channels = network.module.logits.in_channels
    assert features.shape == (channels, SMALL.height, SMALL.width)
    with torch.inference_mode():
        logits = network.module.logits(torch.from_numpy(features)[None])[0].numpy()
    np.testing.assert_allclose(logits, network.logits(image), atol=1e-4)


def test_means_are_over_the_pixels_that_hold_a_point(network, file):
    found = describe_scan(file, network, **PASSES)
    image = project(read_scan(file.path), SMALL)
    pixels = [*zip(*np.nonzero(image.point_of_pixel >= 0), strict=True)]
    assert len(pixels) < image.point_of_pixel.size
    features = pixel_features(network, image).astype(np.float64)
    mean = sum(features[:, v, u] for v, u in pixels) / len(pixels)
    np.testing.assert_allclose(found.features, mean, rtol=1e-9)
    information = sample(network, image, **PASSES).uncertainty.mutual_information
    assert found.uncertainty == pytest.approx(np.mean([information[p] for p in pixels]), rel=1e-6)
    assert found.uncertainty > 0


def test_equal_scans_are_described_alike_whatever_their_names(network, file):
    other = replace(file, sequence="01", stem="000008")
    first, second = (describe_scan(each, network, **PASSES) for each in (file, other))
    assert first.uncertainty == second.uncertainty
    np.testing.assert_array_equal(first.features, second.features)
    again = describe_scan(file, network, samples=3, seed=5)
    assert again.uncertainty != first.uncertainty
    np.testing.assert_array_equal(again.features, first.features)


def test_labels_are_those_of_the_mean_softmax(network, file):
    found, information = label_sampled(file, network, **PASSES)
    image = project(read_scan(file.path), SMALL)
    sampled = sample(network, image, **PASSES)
    refined = knn_refine(image, sampled.probabilities.argmax(axis=0))
    np.testing.assert_array_equal(found.labels, refined)
    np.testing.assert_array_equal(information, sampled.uncertainty.mutual_information)


def test_a_scan_without_a_measurement(weights, tmp_path):
    scan = make_scan(50)
    write_bin(tmp_path / "0.bin", replace(scan, points=np.full_like(scan.points, np.nan)))
    network = load_network(weights, "cpu", engine="torch")
    with pytest.raises(FormatError):
        describe_scan(ScanFile("s", "0", tmp_path / "0.bin"), network, **PASSES)
