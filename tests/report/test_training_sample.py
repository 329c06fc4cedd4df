# SPDX-License-Identifier: MIT
from pathlib import Path

import numpy as np
from matplotlib.image import imread
from scans import SMALL, write_sequence
from tiny_network import TinyNetwork

from salsanext_cli import label_space
from salsanext_cli.engines.loading import network_of_module
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.report.colours import EMPTY, screen_colours
from salsanext_cli.report.training_sample import GAP_PX, ROW_HEIGHT_PX, draw_sample
from salsanext_cli.results.layout import find_scans

SPACE = label_space()


def test_strips_are_range_truth_prediction_and_errors(tmp_path: Path) -> None:
    """A network that says road of everything: its strip has that colour where there is a point."""
    (file,) = find_scans(write_sequence(tmp_path / "00", ["0"], count=600))
    module = TinyNetwork(SPACE.class_count).eval()
    module.logits.weight.data.zero_()
    module.logits.bias.data.zero_()[SPACE.names.index("road")] = 9.0
    card = WeightsCard({"name": "tiny"}, SPACE, SMALL)
    network = network_of_module(module, card, "cpu")
    with (tmp_path / "sample.png").open("wb") as out:
        picture = draw_sample(out, file, network)
    height = ROW_HEIGHT_PX * SMALL.height
    assert picture.shape == (4 * height + 3 * GAP_PX, SMALL.width, 3)
    written = imread(tmp_path / "sample.png")[..., :3]
    np.testing.assert_array_equal((written * 255).round().astype(np.uint8), picture)
    starts = [i * (height + GAP_PX) for i in range(4)]
    _, truth, prediction, _ = (picture[s : s + height : ROW_HEIGHT_PX] for s in starts)
    road = screen_colours(SPACE)[SPACE.names.index("road")]
    filled = (prediction != EMPTY).any(axis=2)
    assert 100 < filled.sum() < filled.size
    assert (prediction[filled] == road).all()
    np.testing.assert_array_equal((truth != EMPTY).any(axis=2)[~filled], False)
    assert len(np.unique(truth[filled], axis=0)) > 3
