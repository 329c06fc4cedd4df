# SPDX-License-Identifier: MIT
from rich.console import Console
from scans import write_weights

from salsanext_cli.report.descriptions import card_table
from salsanext_cli.stages.models import describe_weights


def test_scores_are_rounded_and_a_dash_without_any(tmp_path):
    card = dict(describe_weights(write_weights(tmp_path / "w.safetensors")))
    scores = {"miou": 0.6926549546490874, "iou_[red]": 0.5, "epoch": 20}
    for found, shown in ((scores, "miou 0.693, iou_[red] 0.500, epoch 20 "), (card["scores"], "–")):
        console = Console(width=200)
        with console.capture() as capture:
            console.print(card_table(card | {"scores": found}))
        (line,) = (line for line in capture.get().splitlines() if "scores of" in line)
        assert "scores of the scans that chose the weights" in line
        assert shown in line
