# SPDX-License-Identifier: MIT
"""Stage `tune novelty`, and the distances that `uncertainty` writes with it."""

from dataclasses import replace

import numpy as np
import pytest
from world import World

from salsanext_cli import label_space, project, read_scan, write_labels
from salsanext_cli.errors import LabelError, TrainingError, UsageError, WeightsError
from salsanext_cli.network.card import read_card
from salsanext_cli.stages.evaluate import evaluate
from salsanext_cli.stages.export_ply import export_ply
from salsanext_cli.stages.models import describe_weights
from salsanext_cli.stages.predict import predict_scans
from salsanext_cli.stages.tune_batchnorm import tune_batchnorm
from salsanext_cli.stages.tune_novelty import tune_novelty
from salsanext_cli.stages.uncertainty import uncertainty
from salsanext_cli.storage.layout import NOVELTY, find_scans
from salsanext_cli.storage.selection import ScanSelection
from salsanext_cli.uncertainty.novelty import novelty
from salsanext_cli.uncertainty.settings import Estimator

ALL = ScanSelection()
FEW = Estimator(samples=2, aleatoric="none")


def test_what_is_fitted_is_written_and_evaluated(world: World, target) -> None:
    tuned = tune_novelty(world.data, target, network=world.network, selection=ALL)
    assert tuned["scans"] == 3
    assert 0 < tuned["median"] < tuned["of_99_percent"]
    stored = describe_weights(target)["novelty"]
    assert {"stage": "tune novelty", **stored} == tuned
    network = replace(world.network, weights=target)
    uncertainty(world.data, world.out, network=network, estimator=FEW)
    found = np.load(world.result(NOVELTY, "08", "000001"))
    image = project(read_scan(world.scan("08", "000001")), network.load().sensor)
    expected = novelty(network.load(), image).reshape(-1)[image.pixel_of_point]
    np.testing.assert_array_equal(found, expected)
    assert np.median(found) == pytest.approx(tuned["median"], rel=0.3)
    ranked = evaluate(find_scans(world.data), world.out, label_space()).uncertainty
    assert "novelty" in ranked.to_dict(label_space())["uncertainty"]
    assert export_ply(world.out, colour="novelty", network=network).done == 3
    # Other batch norm has other features.
    adapted = target.with_name("adapted.safetensors")
    tune_batchnorm(world.data, adapted, network=network)
    assert read_card(adapted).novelty is None


def test_weights_without_it(world: World) -> None:
    network = world.network.load()
    image = project(read_scan(world.scan()), network.sensor)
    with pytest.raises(WeightsError, match=r"no novelty .* `salsanext tune novelty"):
        novelty(network, image)
    predict_scans(world.data, world.out, network=world.network)
    with pytest.raises(UsageError, match=r"--colour novelty .* `salsanext tune novelty`"):
        export_ply(world.out, colour="novelty", network=world.network)


def test_labels_that_teach_nothing(world: World, target) -> None:
    paths = sorted((world.data / "sequences").rglob("*.label"))
    for path in paths:
        labels = np.zeros(1500, np.uint32)
        labels[:20] = 10
        write_labels(path, labels)
    with pytest.raises(TrainingError, match="no class has 200 points"):
        tune_novelty(world.data, target, network=world.network, selection=ALL)
    for path in paths:
        write_labels(path, np.zeros(1500, np.uint32))
    with pytest.raises(LabelError, match="no point is of a class that counts"):
        tune_novelty(world.data, target, network=world.network, selection=ALL)
    assert not target.exists()
