# SPDX-License-Identifier: MIT
"""Default weights are finished at each width that they were trained with."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scans import SMALL, salsanext_of, write_sequence
from shallow_network import SHALLOW
from tiny_network import TinyNetwork

from benchmarks.weights import default_weights, finish_weights
from salsanext_cli import label_space
from salsanext_cli.core.network.card import AccuracyLine, WeightsCard
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.network.registry import build
from salsanext_cli.core.uncertainty.error_features import FEATURES
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import save_weights

NARROW = SMALL.width // 2
ARCHITECTURE = {"name": "salsanext", "class_count": 20}
CARD = WeightsCard(ARCHITECTURE, label_space(), SMALL, widths=(SMALL.width, NARROW))


def test_default_weights_have_a_version_and_inherit_nothing(tmp_path, tiny_training, monkeypatch):
    """The temperature of each width is the mean of those of the data sets, and of no other."""
    fitted = {("a", SMALL.width): 1.0, ("b", SMALL.width): 4.0}
    fitted |= {("a", NARROW): 3.0, ("b", NARROW): 3.0}

    def tune(dataset, target, *, settings, overwrite):
        # The temperature is fitted to the weights without what they inherited.
        card = read_card(settings.path)
        assert (card.inherited(), card.temperature, card.parts_of_widths) == ("", 1.0, {})
        after = SimpleNamespace(temperature=fitted[dataset.name, settings.width])
        return SimpleNamespace(fit=SimpleNamespace(after=after))

    monkeypatch.setattr(finish_weights, "tune_temperature", tune)
    mark = "weights of before"
    layers = [(np.ones((len(FEATURES), 1), "f4"), np.zeros(1, "f4"))]
    line = AccuracyLine(1.0, 0.0, 0.1, inherited_from=mark)
    card = replace(CARD, recipe={"class_weight": 0.5}, accuracy=line)
    (tmp_path / "run").mkdir()
    error = ErrorModel(
        features=FEATURES, layers=layers, scores={"inherited_from": mark}, temperature=2.0
    )
    card = replace(card, error=error, version=4)
    of_narrow = replace(card.parts, temperature=7.0)
    card = replace(card, parts_of_widths={NARROW: of_narrow})
    save_weights(tmp_path / "run/last.safetensors", TinyNetwork(), card)
    points = dict.fromkeys(label_space().names, 10)
    (tmp_path / "run/class_counts.json").write_text(json.dumps({"points": points}))
    datasets = [tmp_path / "a", tmp_path / "b"]
    default_weights.finish(tmp_path / "run", datasets, tmp_path / "default.safetensors", "Trained.")
    finished = read_card(tmp_path / "default.safetensors")
    assert (finished.version, finished.description) == (finish_weights.VERSION, "Trained.")
    assert (finished.error, finished.accuracy) == (None, None)
    assert finished.temperature == pytest.approx(2.0)
    assert finished.at_width(NARROW).temperature == pytest.approx(3.0)


@pytest.mark.slow
@pytest.mark.usefixtures("one_step_fits")
def test_default_weights_get_an_error_model_of_all_sequences_and_int8_ranges(tmp_path, monkeypatch):
    monkeypatch.setattr(finish_weights, "CORRUPTIONS", 1)
    weights, datasets = tmp_path / "w.safetensors", [tmp_path / "a", tmp_path / "b"]
    space = label_space().to_dict() | {"split": {"train": ["00"], "valid": ["08", "09"]}}
    for dataset in datasets:
        for number in ("00", "08", "09"):
            write_sequence(dataset / "sequences" / number, ["0"], seed=int(number))
        (dataset / "labels.yaml").write_text(json.dumps(space))
    monkeypatch.setattr("salsanext_cli.training.tuning.error_training.EPOCHS", 1)
    with salsanext_of(**SHALLOW):
        save_weights(weights, build(CARD.architecture), CARD)
        finish_weights.add_error_models(weights, datasets)
        finish_weights.add_int8(weights, datasets)
    card = read_card(weights)
    assert card.int8
    narrow = card.at_width(NARROW)
    for error in (card.error, narrow.error):
        assert error.scores["sequences"] == ["a/08", "a/09", "b/08", "b/09"]
        assert error.scores["points"] > 4 * 1000
    assert narrow.error.scores["error"] != card.error.scores["error"]
    assert narrow.parts_of_default_width() == f"temperature of images of {SMALL.width} columns"
