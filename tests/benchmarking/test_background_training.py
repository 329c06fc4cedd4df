# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""Training in the background, and the scores of its weights on drives."""

import csv
import json

import pytest
from command_line import called
from scans import SMALL, write_sequence
from shallow_network import shallow, weights  # noqa: F401

from benchmarks.weights import background_training, drive_scores, scene_pool
from benchmarks.weights.scene_pool import KINDS, ScenePool, write_scene
from salsanext_cli.io.weights.card_file import read_card

TINY = (
    "widths=64,32",
    "crop_width=32",
    "samples_per_epoch=4",
    "batch=2",
    "precision=float32",
    "no_intensity=0",
)


@pytest.mark.slow
def test_a_training_goes_on_where_it_ended_and_its_average_becomes_weights(tmp_path, weights):
    scenes = [str(tmp_path / "scenes"), "--scenes", "1", "--scans", "2", "--weights", str(weights)]
    scene_pool.main(*scenes)
    made = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("scenes/**/*.bin")}
    assert len(made) == 2 * len(KINDS)
    scene_pool.main(*scenes)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("scenes/**/*.bin")} == made
    for number, kind in enumerate(KINDS):
        write_scene(tmp_path / "held-out" / kind, 0, kind, 9 + number, 1, 10.0, SMALL)
    run, target = tmp_path / "run", tmp_path / "average.safetensors"
    call = [*map(str, (run, tmp_path / "scenes", tmp_path / "held-out", "--weights", weights))]
    settings = [word for text in TINY for word in ("--set", text)]
    for epochs in (1, 2):
        background_training.main(*call, *settings, "--set", f"epochs={epochs}")
        rows = list(csv.DictReader((run / "scores.csv").read_text().splitlines()))
        assert [int(row["step"]) for row in rows] == [2, 4][:epochs]
        assert {f"{kind}_miou{end}" for kind in KINDS for end in ("", "_32")} <= rows[0].keys()
    background_training.main(*call, *settings, "--write", str(target))
    assert read_card(target).trained_widths == (64, 32)


def test_of_processes_that_ask_for_one_scene_one_makes_it(tmp_path, monkeypatch):
    """The draft of a process that was killed is replaced, that of a living one is not."""
    pool, made = ScenePool(tmp_path, SMALL), []
    draft = tmp_path / KINDS[0] / "drafts/sequences/000003"
    left = draft / "left"

    def write(root, number, kind, *_):
        made.append((kind, number))
        assert not left.exists()
        draft.mkdir(parents=True)
        left.touch()
        ScenePool(tmp_path, SMALL).complete(3 * len(KINDS))
        assert left.exists()
        (root / "sequences").mkdir(exist_ok=True)
        draft.rename(root / "sequences" / draft.name)

    monkeypatch.setattr(scene_pool, "write_scene", write)
    draft.mkdir(parents=True)
    left.touch()
    for _ in range(2):
        pool.complete(3 * len(KINDS))
    assert made == [(KINDS[0], 3)]


@pytest.mark.slow
def test_scores_of_drives_are_those_of_eval(tmp_path, weights, monkeypatch):
    monkeypatch.setenv("SALSANEXT_ENGINE", "torch")
    for name in ("00", "08"):
        write_sequence(tmp_path / "data/sequences" / name, ["0", "1"])
    found = tmp_path / "scores.json"
    words = [str(weights), str(tmp_path / "data"), "--widths", "128,64", "--json", str(found)]
    drive_scores.main(*words, "--classes", "car")
    scores = json.loads(found.read_text())
    assert scores.keys() == {"128", "64"}
    for width in scores:
        out = tmp_path / f"out {width}"
        call = ("predict", tmp_path / "data", out, "--weights", weights, "--width", width)
        called(*call, "--sequences", "08", "--precision", "float32")
        judged = json.loads(called("eval", out, "--json").stdout)["scores"]
        assert scores[width]["08"]["accuracy"] == pytest.approx(100 * judged["accuracy"], abs=0.01)
        assert scores[width]["08"]["miou"] == pytest.approx(
            100 * judged["iou_mean_present"], abs=0.01
        )
