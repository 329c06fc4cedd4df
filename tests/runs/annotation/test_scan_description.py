# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""Features of scans, and of points that tell how likely a label is wrong."""

import math
from dataclasses import replace

import numba
import numpy as np
import pytest
import torch
from scans import SMALL, make_scan, write_bin, write_sequence
from scipy.special import softmax
from shallow_network import shallow, weights  # noqa: F401

from salsanext_cli import Scan, load_network, project, read_scan, sample
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.uncertainty.error_features import FEATURES, error_features
from salsanext_cli.runs.annotation.scan_description import DescribeJob, pixel_features
from salsanext_cli.runs.loop.pipeline import Pipeline
from salsanext_cli.runs.scans.scan_file import ScanFile

PASSES = {"samples": 3, "seed": 4}


@pytest.fixture
def network(request, weights):
    return load_network(weights, "cpu", engine=getattr(request, "param", "torch"))


@pytest.fixture
def file(tmp_path) -> ScanFile:
    folder = write_sequence(tmp_path / "00", ["000007"])
    return ScanFile(sequence="00", stem="000007", path=folder / "velodyne/000007.bin")


def describe_scan(file, network, samples, seed):
    (found,) = Pipeline(job=DescribeJob(network=network, samples=samples, seed=seed)).results(
        [file]
    )
    return found


@pytest.mark.parametrize("network", ["torch", "openvino"], indirect=True)
def test_the_features_are_what_the_logits_are_made_of(network):
    image = project(make_scan(), SMALL)
    features = pixel_features(network, network.input(image.channels))
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
    features = pixel_features(network, network.input(image.channels)).astype(np.float64)
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


def test_a_scan_without_a_measurement(weights, tmp_path):
    scan = make_scan(50)
    write_bin(tmp_path / "0.bin", replace(scan, points=np.full_like(scan.points, np.nan)))
    network = load_network(weights, "cpu", engine="torch")
    with pytest.raises(FormatError):
        describe_scan(ScanFile(sequence="s", stem="0", path=tmp_path / "0.bin"), network, **PASSES)


@pytest.mark.usefixtures("small_slices")
@pytest.mark.parametrize("threads", [1, 5])
@pytest.mark.parametrize(
    ("count", "width", "block"),
    [(0, 128, 1), (1, 128, 1), (40, 8, 2), (900, 128, 1), (900, 128, 12), (9000, 128, 7)],
)
def test_features_are_those_of_a_slow_loop(count, width, block, threads, monkeypatch):
    """Large blocks of pixels are alike, so that regions are; of many points some are compared."""
    monkeypatch.setitem(vars(numba.config), "NUMBA_NUM_THREADS", threads)
    random = np.random.default_rng(count + block)
    points = random.normal(size=(count, 3)).astype("f4") * np.float32([8, 8, 0.7])
    scan = Scan(points, random.random(count).astype("f4"))
    # Points in the origin have no pixel: some where the threads' slices meet.
    borders = [count * part // threads for part in range(threads) if count > threads]
    scan.points[[border - step for border in borders for step in (0, 1)]] = 0
    image = project(scan, replace(SMALL, width=width))
    random = np.random.default_rng(block)
    coarse = random.normal(size=(4, image.height // block + 1, image.width // block + 1))
    logits = coarse.repeat(block, 1).repeat(block, 2)[:, : image.height, : image.width]
    logits = 3 * logits + random.normal(size=logits.shape) * (0.3 if block > 1 else 1)
    probabilities = softmax(logits, axis=0).astype("f4")
    labels = random.integers(0, 4, count).astype(np.uint8)
    found = error_features(image, probabilities, labels)
    assert found.shape == (count, len(FEATURES))
    ranges = image.channels[0]
    classes, largest = probabilities.argmax(axis=0), probabilities.max(axis=0)
    for i in range(0, count, 1 + count // 400):
        if image.pixel_of_point[i] < 0:
            assert np.isnan(found[i]).all()
            continue
        v, u = divmod(int(image.pixel_of_point[i]), image.width)
        own = sorted(probabilities[:, v, u].tolist())
        around = [
            probabilities[labels[i], v + dv, (u + du) % image.width]
            for dv in (-4, -2, 0, 2, 4)
            for du in range(-8, 9, 2)
            if 0 <= v + dv < image.height
            and ranges[v + dv, (u + du) % image.width] > 0
            and abs(ranges[v + dv, (u + du) % image.width] - ranges[v, u])
            <= max(1, 0.05 * ranges[v, u])
        ]
        log_range = math.log(max(image.point_range[i], 0.5))
        expected = [
            probabilities[labels[i], v, u],
            own[-1],
            own[-1] - own[-2],
            -sum(p * math.log(p) for p in own),
            np.mean(around),
            np.mean([largest[place] for place in region(ranges > 0, classes, (v, u))]),
            log_range - math.log(max(ranges[v, u], 0.5)),
            log_range,
            image.channels[3, v, u],
        ]
        assert found[i] == pytest.approx(expected, abs=1e-5)


def region(occupied, classes, start: tuple[int, int]) -> set[tuple[int, int]]:
    """Return the pixels that can be reached from one in steps between pixels of its class."""
    height, width = occupied.shape
    steps = [(dv, du) for dv in (-1, 0, 1) for du in (-1, 0, 1)]
    steps += [(0, 2), (0, -2), (2, 0), (-2, 0)]
    found, waiting = {start}, [start]
    while waiting:
        v, u = waiting.pop()
        for dv, du in steps:
            place = (v + dv, (u + du) % width)
            free = 0 <= place[0] < height and occupied[place] and place not in found
            if free and classes[place] == classes[start]:
                found.add(place)
                waiting.append(place)
    return found
