# SPDX-License-Identifier: MIT
import logging
import math

import numpy as np
import pytest
from scans import SMALL, write_weights

from salsanext_cli import label_space, load_network, project, read_labels, read_scan, sample
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.network.card import read_card
from salsanext_cli.network.dropout import dropouts
from salsanext_cli.network.weights import read_weights
from salsanext_cli.stages.tune import tune
from salsanext_cli.training.tuning.dropout_rate import MIN_VARIANCE
from salsanext_cli.uncertainty.aleatoric import aleatoric
from salsanext_cli.uncertainty.monte_carlo import scan_seed

SPACE = label_space()
FEW = {"samples": 3, "steps": 3, "lowest": 0.05, "highest": 0.3}


def go(world, target, **changes):
    return tune("dropout", world.data, target, **{"settings": world.network, **FEW, **changes})


def slow_mean(world, path, rate, stems, seed=0):
    """Return the objective of one rate by a loop over points, from weights of that rate."""
    network = load_network(write_weights(path, dropout=rate), "cpu", engine="torch")
    total, count = 0.0, 0
    for stem in stems:
        scan = world.scan("08", stem)
        image = project(read_scan(scan), SMALL)
        labels = SPACE.to_train(read_labels(scan.parent.parent / "labels" / f"{stem}.label"))
        of_scan = scan_seed(seed, "08", stem)
        sampled = sample(network, image, samples=FEW["samples"], seed=of_scan)
        variance = sampled.variance.astype(np.float64) + aleatoric(network, image)
        for point, label in enumerate(labels):
            if label == 0 or image.pixel_of_point[point] < 0:
                continue
            row, column = divmod(int(image.pixel_of_point[point]), image.width)
            s = np.maximum(variance[:, row, column], MIN_VARIANCE)
            error = np.eye(20)[label] - sampled.probabilities[:, row, column]
            total += (0.5 * np.log(s) + error**2 / (2 * s)).sum()
            count += 1
    return total / count


def test_every_rate_against_a_slow_loop_and_the_least_is_stored(world, target, tmp_path):
    tuned = go(world, target)
    slow = [
        slow_mean(world, tmp_path / "w.safetensors", rate, ["000000", "000001"])
        for rate in tuned["rates"]
    ]
    np.testing.assert_allclose(tuned["objectives"], slow, rtol=1e-5)
    np.testing.assert_allclose(tuned["rates"], [0.05, math.sqrt(0.05 * 0.3), 0.3])
    assert tuned["best"] == tuned["rates"][int(np.argmin(slow))]
    assert tuned["before"] == 0.2
    assert tuned["scans"] == 2
    assert read_card(target).architecture["dropout"] == tuned["best"]
    assert {layer.rate for layer in dropouts(read_weights(target)[0])} == {tuned["best"]}


def test_a_network_that_was_trained_without_dropout_gets_it_where_the_paper_has_it(
    world, target, tmp_path
):
    certain = write_weights(tmp_path / "certain.safetensors", dropout=0.0)
    tuned = go(world, target, settings=NetworkSettings(certain, "cpu", engine="torch"))
    assert tuned["before"] == 0
    assert len(dropouts(read_weights(target)[0])) == 3 + 1 + 3 * 3
    assert tuned["objectives"] == go(world, target, overwrite=True)["objectives"]


@pytest.mark.parametrize(
    ("objectives", "best", "says"),
    [
        ([1.0, 2.0, 3.0], 0.05, "best rate, 0.05, is the last of the range: move --lowest"),
        ([3.0, 1.0, 2.0], math.sqrt(0.05 * 0.3), ""),
    ],
)
def test_the_end_of_the_range_is_named(world, target, caplog, monkeypatch, objectives, best, says):
    values = iter(objectives * 2)
    module = "salsanext_cli.training.tuning.dropout_rate"
    monkeypatch.setattr(f"{module}.objective", lambda *_: next(values))
    with caplog.at_level(logging.WARNING):
        assert go(world, target)["best"] == pytest.approx(best)
    assert says in caplog.text
    assert bool(caplog.text) == bool(says)
