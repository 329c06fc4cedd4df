# SPDX-License-Identifier: MIT
"""Files that show a training: after every epoch, and again after a new start."""

import json
import sys
from dataclasses import replace
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from matplotlib.image import imread
from scans import SMALL, files_below, refused, write_sequence

from salsanext_cli.commands.jobs import epoch_files
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.commands.stages.train import train
from salsanext_cli.core.errors import MissingDependency, OutputError
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.recipe import Recipe

tiny = pytest.mark.usefixtures("tiny_training")
RECIPE = Recipe(epochs=2, batch=2, samples_per_epoch=2, crop_width=32, precision="float32")
PICTURES = ("curve.png", "samples.png", "training.html")


@pytest.fixture
def labelled(tmp_path):
    """Return a data set with training and validation scans."""
    for name in ("00", "08"):
        write_sequence(tmp_path / "data/sequences" / name, ["000000", "000001"])
    return tmp_path / "data"


@tiny
@pytest.mark.drawn
def test_every_epoch_writes_the_pictures(labelled, tmp_path, monkeypatch):
    run, seen = tmp_path / "run", []
    write = epoch_files.write_epoch_files

    def written(epoch):
        write(epoch)
        seen.append((len(epoch.rows), epoch.is_validation, (run / "curve.png").read_bytes()))

    monkeypatch.setattr(epoch_files, "write_epoch_files", written)
    train(labelled, run, recipe=RECIPE, sensor=SMALL, device="cpu")
    assert [(rows, is_validation) for rows, is_validation, _ in seen] == [(1, True), (2, True)]
    assert seen[0][2] != seen[1][2]
    assert {*PICTURES} <= files_below(run).keys()
    # Two validation scans have three strips each.
    height, width, _ = imread(run / "samples.png").shape
    assert width > 2048
    assert height > 6 * 128
    page = (run / "training.html").read_text("utf-8")
    assert "epoch 2 of 2" in page
    assert 'http-equiv="refresh"' not in page


@tiny
def test_a_failed_picture_does_not_end_the_training(labelled, tmp_path, monkeypatch, caplog):
    run = tmp_path / "run"

    def fail(epoch):
        raise RuntimeError(f"no memory for epoch {len(epoch.rows)}")

    monkeypatch.setattr(epoch_files, "write_epoch_files", fail)
    train(labelled, run, recipe=RECIPE, sensor=SMALL, device="cpu")
    assert (run / "best.safetensors").exists()
    messages = [record.getMessage() for record in caplog.records]
    assert [str(run) in text for text in messages if "no memory" in text] == [True]


@tiny
def test_pictures_of_the_user_stay(labelled, tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    (run / "curve.png").write_bytes(b"mine")
    with pytest.raises(OutputError):
        train(labelled, run, recipe=RECIPE, sensor=SMALL, device="cpu")
    assert (run / "curve.png").read_bytes() == b"mine"


def test_samples_are_the_labels_of_predict(world):
    """The sample of a scan has the pixel labels that `predict` writes."""
    settings = replace(world.network, fit=False, intensity="raw")
    predict_scans(world.data, world.out, settings=settings, extras=("pixel_labels",))
    network = settings.load()
    sensor = Provenance(world.out).sensor()
    source = Source(files=find_scans(world.data), space=network.space, sensor=sensor)
    for file in source.files:
        sample = epoch_files.sample_labels(file, source, network.for_sensor(sensor))
        labels = np.load(world.result("pixel_labels", file.sequence, file.stem))
        assert (sample.predicted == labels)[sample.occupied].all()
        assert 0 < sample.occupied.mean() < 1
        assert not sample.truth[~sample.occupied].any()
        assert sample.truth.any()


@tiny
def test_tensorboard_must_be_installed(labelled, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    with pytest.raises(MissingDependency) as caught:
        train(
            labelled, tmp_path / "run", recipe=RECIPE, sensor=SMALL, device="cpu", tensorboard=True
        )
    assert caught.value.subject == "tensorboard"
    assert not (tmp_path / "run").exists()


@pytest.fixture
def tensorboard(monkeypatch):
    """Stand in for TensorBoard, which is large: events are lines of JSON."""

    class Writer:
        def __init__(self, file):
            self.file = file

        def write(self, record):
            self.file.write(record + b"\n")

    class Event(SimpleNamespace):
        def SerializeToString(self):  # noqa: N802
            return json.dumps(vars(self)).encode()

    class Summary:
        def __new__(cls, value):
            return value

        @staticmethod
        def Value(tag, simple_value):  # noqa: N802
            return tag, simple_value

    modules = {
        "tensorboard": {},
        "tensorboard.compat.proto.event_pb2": {"Event": Event},
        "tensorboard.compat.proto.summary_pb2": {"Summary": Summary},
        "tensorboard.summary.writer.record_writer": {"RecordWriter": Writer},
    }
    for name, members in modules.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)


@tiny
@pytest.mark.usefixtures("tensorboard")
def test_events_have_the_rows_of_the_log(labelled, tmp_path):
    """A new training removes those of the earlier one, and no file of the user."""
    run = tmp_path / "run"
    settings = {"sensor": SMALL, "device": "cpu", "tensorboard": True}
    result = train(labelled, run, recipe=RECIPE, **settings)
    logged = {}
    for path in (run / "events").iterdir():
        assert "tfevents" in path.name
        _, event = map(json.loads, path.read_text().splitlines())
        logged |= {(tag, event["step"]): value for tag, value in event["summary"]}
    for row in result.rows:
        for key, value in row.items():
            if key != "epoch" and value == value:
                assert logged.pop((key.replace("iou_", "iou/", 1), int(row["epoch"]))) == value
    assert not logged
    (run / "events/notes.txt").write_text("mine")
    fewer = RECIPE.with_changes(epochs=1)
    train(labelled, run, recipe=fewer, overwrite=True, **settings)
    names = [path.name for path in sorted((run / "events").iterdir())]
    assert names == ["events.out.tfevents.000001", "notes.txt"]
    (run / "events" / names[0]).write_text("mine")
    with refused(OutputError, run / "events" / names[0]):
        train(labelled, run, recipe=fewer, overwrite=True, **settings)
