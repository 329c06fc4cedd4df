# SPDX-License-Identifier: MIT
"""The baseline of the benchmark and the product compute the same."""

import sys
from dataclasses import replace

import baseline as plain
import numpy as np
import pytest
import speed_product as product
import torch
from scans import SMALL, make_scan

from salsanext_cli import RangeImage, Scan, knn_refine, load_network, project, read_labels
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.formats.kitti import write_bin
from salsanext_cli.stages.predict import predict_scans
from salsanext_cli.uncertainty.aleatoric import aleatoric

ODD = replace(SMALL, height=17, width=120)
"""A size that the network has to pad."""


def table_of(scan: Scan) -> np.ndarray:
    return np.column_stack((scan.points, scan.intensity))


def with_holes(image: RangeImage) -> np.ndarray:
    """Return the channels as the baseline has them: -1 where a pixel is empty."""
    return np.where(image.channels[0] > 0, image.channels, np.float32(-1))


def is_inner(image: RangeImage) -> np.ndarray:
    """Return which points have a window that lies in the image."""
    v, u = np.divmod(image.pixel_of_point, image.width)
    return (v >= 2) & (v < image.height - 2) & (u >= 2) & (u < image.width - 2)


@pytest.mark.parametrize("out_of_view", ["clamp", "drop"])
@pytest.mark.parametrize("fov_up", [3.0, -2.0])
def test_same_pixels_but_for_rounding(out_of_view, fov_up):
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


def test_same_neighbours_but_for_the_published_rules():
    """The published image has an end, padding that votes, and a class 1 for nobody's vote."""
    image = project(make_scan(20_000), SMALL)
    labels = np.random.default_rng(0).integers(0, 20, (SMALL.height, SMALL.width))
    labels[3:10, 20:60] = 0
    ours = knn_refine(image, labels)
    ranges, points = with_holes(image)[0], (image.pixel_of_point, image.point_range)
    theirs = plain.vote(ranges, labels, *points, 20, torch.device("cpu"))
    inner, voted = is_inner(image), ours > 0
    assert inner.mean() > 0.6
    np.testing.assert_array_equal(theirs[inner & voted], ours[inner & voted])
    assert (inner & ~voted).any()
    assert set(theirs[inner & ~voted]) == {1}


def test_script_and_benchmark_label_a_scan_as_predict_does(tmp_path, weights, monkeypatch):
    """No window of the points compared reaches an edge of the image, and all have a label."""
    scan, file = make_scan(), tmp_path / "000000.bin"
    write_bin(file, scan)
    words = ("baseline.py", file, tmp_path / "plain.label", "--weights", weights)
    monkeypatch.setattr(sys, "argv", [*map(str, words)])
    plain.main()
    product.predict(file, tmp_path / "product.label", load_network(weights, "cpu"))
    predict_scans(file, tmp_path / "out", settings=NetworkSettings(weights, device="cpu"))
    (stage,) = (tmp_path / "out").rglob("*.label")
    assert (tmp_path / "product.label").read_bytes() == stage.read_bytes()
    theirs, labels = (read_labels(path, 1500) for path in (tmp_path / "plain.label", stage))
    compared = is_inner(project(scan, SMALL)) & (labels > 0)
    assert compared.mean() > 0.5
    assert np.mean(theirs[compared] != labels[compared]) <= 2e-3


@pytest.mark.slow
def test_both_sides_of_a_benchmark_do_the_same(tmp_path, weights):
    scan, sensor = tmp_path / "0.bin", ODD.to_dict()
    write_bin(scan, make_scan())
    image = project(make_scan(), ODD)
    _, variance = plain.Baseline(weights, sensor=sensor).aleatoric(with_holes(image))
    of_input = aleatoric(load_network(weights, "cpu", ODD), image)
    np.testing.assert_allclose(variance.numpy(), of_input, rtol=1e-3, atol=1e-12)
    task = {"weights": weights, "device": "cpu", "precision": "float32", "engine": "auto"}
    task |= {"sensor": sensor, "passes": 3, "samples": 3}
    for part in ("network", "knn", "confusion", "uncertainty"):
        theirs, ours = (side.prepare(part, scan, task)() for side in (plain, product))
        if part == "network":
            np.testing.assert_allclose(theirs, ours, atol=1e-4)
        elif part == "knn":
            assert np.mean(theirs == ours) > 0.8
        elif part == "confusion":
            assert theirs.sum() == ours.matrix.sum() == 1500
        else:
            # Three passes with other masks: alike on average.
            found = ours.uncertainty
            assert theirs[1].mean() == pytest.approx(found.epistemic.mean(), rel=0.5)
            assert theirs[2].mean() == pytest.approx(found.aleatoric.mean(), rel=0.5)
