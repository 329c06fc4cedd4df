# SPDX-License-Identifier: MIT
"""The plan of a training states what the training then does, and changes nothing."""

import json
import os

import numpy as np
import pytest
import torch
from command_line import only_json
from safetensors.torch import load_file
from scans import SMALL, files_below, write_sequence
from tiny_network import TinyNetwork

from salsanext_cli import label_space, read_labels
from salsanext_cli.commands.jobs.plans.training_plan import TrainingPlan, _checkpoint_bytes
from salsanext_cli.training.checkpoint import TrainingState, save_checkpoint
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.run_folder import BEST, CHECKPOINT, LAST

pytestmark = pytest.mark.usefixtures("tiny_training")


@pytest.fixture
def dataset(tmp_path):
    """Three scans to train on and two to score on, by SemanticKITTI's split."""
    root = tmp_path / "data"
    write_sequence(root / "sequences" / "00", ["0", "1", "2"], count=600)
    write_sequence(root / "sequences" / "08", ["0", "1"], count=600)
    return root


@pytest.fixture
def train(run, dataset, tmp_path):
    """Return a function that runs `train` on small images; keywords change the recipe."""
    sensor = tmp_path / "small.toml"
    sensor.write_text(SMALL.to_toml())

    def train(*words, status=0, **changes):
        recipe = {"batch": 2, "crop_width": 32, "precision": "float32", "epochs": 2, **changes}
        settings = [word for key in recipe for word in ("--set", f"{key}={recipe[key]}")]
        call = ("train", dataset, tmp_path / "run", "--sensor", sensor, "--device", "cpu")
        return run(*call, *settings, *words, "--json", status=status)

    return train


@pytest.mark.parametrize("changes", [{}, {"optimiser": "adamw", "average": 0.5}])
def test_a_plan_states_scans_classes_steps_and_size(train, dataset, tmp_path, changes):
    before = files_below(tmp_path)
    plan = only_json(train("--dry-run", **changes))
    assert files_below(tmp_path) == before
    assert not (tmp_path / "run").exists()
    assert (plan["training"], plan["validation"], plan["sampled"]) == (3, 2, 3)
    assert (plan["epochs"], plan["complete"], plan["steps"], plan["folds"]) == (2, 0, 2, 0)
    space = label_space()
    labels = [read_labels(path) for path in (dataset / "sequences/00/labels").iterdir()]
    points = np.bincount(space.to_train(np.concatenate(labels)), minlength=space.class_count)
    scored = [name for name, is_scored in zip(space.names, space.scored, strict=True) if is_scored]
    assert plan["points"] == {name: points[space.names.index(name)] for name in scored}
    train(**changes)
    run = tmp_path / "run"
    assert len((run / "log.csv").read_text().splitlines()) == 1 + plan["epochs"]
    written = sum((run / name).stat().st_size for name in (BEST, LAST, CHECKPOINT))
    # The tensors of a tiny network are as small as their names; the next test counts them.
    assert plan["bytes"] == pytest.approx(written, abs=20_000)
    again = only_json(train("--dry-run", **changes))
    assert again["complete"] == 2
    longer = only_json(train("--dry-run", "--epochs", 5, **changes))
    assert (longer["epochs"], longer["complete"]) == (5, 2)
    assert only_json(train("--dry-run", "--overwrite", **changes))["complete"] == 0


@pytest.mark.parametrize("optimiser", ["sgd", "adamw"])
@pytest.mark.parametrize("average", [0.0, 0.9])
def test_the_size_of_a_checkpoint_is_that_of_its_tensors(tmp_path, optimiser, average):
    recipe = Recipe(epochs=1, optimiser=optimiser, average=average)
    learner = Learner(TinyNetwork(3), recipe, torch.ones(3), torch.device("cpu"))
    images = torch.randn(2, 5, 16, 16)
    learner.step(images, torch.ones(2, 16, 16, dtype=torch.uint8), 0, 1)
    save_checkpoint(tmp_path / CHECKPOINT, learner, TrainingState())
    saved = load_file(tmp_path / CHECKPOINT)
    # AdamW counts the steps of each parameter, in four bytes.
    counts = [name for name in saved if name.endswith(".step")]
    stated = _checkpoint_bytes(learner.module, recipe)
    assert stated == sum(tensor.nbytes for tensor in saved.values()) - 4 * len(counts)


def test_further_data_sets_and_folds_are_stated(train, dataset, tmp_path):
    further = tmp_path / "further"
    write_sequence(further / "sequences/00", ["0", "1"], count=600)
    plan = only_json(train("--dry-run", "--also", further))
    # Five scans make three batches of two.
    assert (plan["further"], plan["steps"]) == (2, 3)
    announced = train("--also", further, "--epochs", 1).stderr
    assert "an epoch has 6 images of 16×32 in 3 steps" in announced
    for path in (dataset / "sequences/08").rglob("*.*"):
        path.unlink()
    folds = only_json(train("--dry-run", "--overwrite", folds=3))
    single = only_json(train("--dry-run", "--overwrite", folds=2))
    assert (folds["folds"], folds["training"], folds["validation"]) == (3, 3, 0)
    assert folds["bytes"] * 3 == single["bytes"] * 4


@pytest.mark.parametrize("fault", ["label", "split", "class", "settings", "foreign"])
def test_a_plan_refuses_what_the_training_refuses(train, dataset, tmp_path, fault):
    changes = {}
    labels = dataset / "sequences/00/labels"
    match fault:
        case "label":
            (labels / "1.label").unlink()
        case "split":
            (dataset / "sequences/00").rename(dataset / "sequences/99")
        case "class":
            for path in labels.iterdir():
                path.write_bytes(bytes(path.stat().st_size))
        case "settings":
            train()
            changes = {"learning_rate": 0.5}
        case "foreign":
            (tmp_path / "run").mkdir()
            (tmp_path / "run" / BEST).write_text("mine")
    before = files_below(tmp_path)
    planned = train("--dry-run", status=1, **changes).stdout
    assert files_below(tmp_path) == before
    assert "error" in json.loads(planned)
    assert json.loads(planned) == json.loads(train(status=1, **changes).stdout)


@pytest.mark.parametrize("is_file", [True, False])
def test_a_plan_refuses_a_folder_that_cannot_be_written(train, tmp_path, monkeypatch, is_file):
    if is_file:
        (tmp_path / "run").write_text("mine")
        assert json.loads(train(status=1).stdout)["code"] == "output"
    else:
        monkeypatch.setattr(os, "access", lambda _, mode, **__: not mode & os.W_OK)
    refused = json.loads(train("--dry-run", status=1).stdout)
    assert refused["code"] == "output"
    assert refused["error"].startswith(f"{tmp_path / 'run'}: cannot be written")


def test_lines_name_what_is_absent():
    plan = TrainingPlan(
        training=40,
        validation=0,
        further=5,
        simulated=16,
        sampled=16,
        points={"car": 3, "road": 0},
        sensor=SMALL,
        steps=1,
        epochs=2,
        done=1,
        folds=4,
        size=10,
    )
    scans, classes, epochs = plan.lines()
    assert scans == "40 scans for training, 0 for validation, 5 of further data sets, 16 simulated"
    assert classes == "scored classes in 16 scans: 1 of 2, without road"
    trained = "at most 2 epochs of 1 step, 1 done already"
    assert epochs == f"{trained}, after 4 folds of at most 2 epochs each"
