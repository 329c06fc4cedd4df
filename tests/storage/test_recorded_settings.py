# SPDX-License-Identifier: MIT
import json
from functools import reduce
from pathlib import Path

import pytest

from salsanext_cli.errors import OutputError
from salsanext_cli.stages.evaluate import evaluate
from salsanext_cli.stages.export_ply import export_ply
from salsanext_cli.stages.knn_refine import knn_refine_scans
from salsanext_cli.stages.predict import predict_range_images, predict_scans
from salsanext_cli.stages.project import project_scans
from salsanext_cli.stages.uncertainty import uncertainty
from salsanext_cli.storage.predictions import predicted_scans
from salsanext_cli.storage.recorded_settings import RecordedSettings
from salsanext_cli.storage.selection import ScanSelection
from salsanext_cli.uncertainty.settings import Estimator

SETTINGS = RecordedSettings(
    {"n": 3, "x": 0.5, "endless": "Infinity", "pair": [1, 2.5], "in": {"k": 5}, "yes": True},
    Path("out/predict.json"),
)


def change(path, *keys, to=None):
    """Take a setting out of a record, or put another value in its place."""
    record = json.loads(path.read_text())
    *inner, last = keys
    table = reduce(lambda found, key: found[key], inner, record["settings"])
    if to is None:
        del table[last]
    else:
        table[last] = to
    path.write_text(json.dumps(record))


def test_settings_are_read_back():
    assert SETTINGS.integer("n") == 3
    assert (SETTINGS.number("x"), SETTINGS.number("n")) == (0.5, 3.0)
    assert SETTINGS.number("endless") == float("inf")
    assert SETTINGS.pair("pair") == (1.0, 2.5)
    assert SETTINGS.table("in")["k"] == 5
    assert SETTINGS.get("none") is None


@pytest.mark.parametrize("read", ["flag", "integer", "number", "pair", "table", "__getitem__"])
def test_what_was_cut_out_is_named(read):
    with pytest.raises(OutputError, match=r"out/predict\.json · settings lack none · .*delete it"):
        getattr(SETTINGS, read)("none")
    with pytest.raises(OutputError, match=r"out/predict\.json · settings lack none"):
        SETTINGS.table("in")["none"]


@pytest.mark.parametrize(
    ("read", "key"),
    [
        *(("flag", key) for key in ("n", "pair", "in")),
        *(("integer", key) for key in ("x", "endless", "pair", "in", "yes")),
        *(("number", key) for key in ("pair", "in", "yes")),
        *(("pair", key) for key in ("n", "endless", "in")),
        *(("table", key) for key in ("n", "pair", "endless")),
    ],
)
def test_what_was_put_in_is_named(read, key):
    with pytest.raises(OutputError, match=rf"out/predict\.json · settings have {key} "):
        getattr(SETTINGS, read)(key)


@pytest.fixture
def exported(world):
    predict_scans(world.data, world.out, network=world.network, selection=ScanSelection(limit=2))
    export_ply(world.out, colour="range")
    return world


@pytest.mark.parametrize("scale", [None, 3, [1], ["a", "b"]])
def test_a_record_of_export_without_its_scale(exported, scale):
    change(exported.out / "export-ply.json", "scale", to=scale)
    with pytest.raises(OutputError, match=r"export-ply\.json · settings (lack|have) scale"):
        export_ply(exported.out, colour="range")


@pytest.mark.parametrize("key", ["label_space", "sensor", "weights"])
def test_a_record_of_predict_without_a_part(exported, key):
    change(exported.out / "predict.json", key)
    with pytest.raises(OutputError, match=rf"predict\.json · settings lack {key}"):
        export_ply(exported.out, colour="epistemic", network=exported.network)


def test_a_record_of_predict_stops_eval(exported):
    change(exported.out / "predict.json", "label_space", to=7)
    with pytest.raises(OutputError, match=r"predict\.json · settings have label_space 7"):
        evaluate(*predicted_scans(exported.out, ScanSelection()), exported.out)


def test_a_record_of_project_without_its_sensor(world):
    project_scans(world.data, world.out, sensor=world.network.load().sensor)
    change(world.out / "project.json", "sensor")
    for stage in (
        lambda: predict_range_images(world.out, world.out, network=world.network),
        lambda: knn_refine_scans(world.out, labels=world.data / "sequences/08/labels"),
    ):
        with pytest.raises(OutputError, match=r"project\.json · settings lack sensor"):
            stage()


@pytest.mark.parametrize(
    "keys", [("method",), ("samples",), ("seed",), ("aleatoric",), ("knn",), ("knn", "cutoff")]
)
def test_a_record_of_uncertainty_without_a_part(world, keys):
    first = {"selection": ScanSelection(limit=1), "estimator": Estimator(samples=2)}
    predict_scans(world.data, world.out, network=world.network)
    uncertainty(world.data, world.out, network=world.network, **first)
    change(world.out / "uncertainty.json", *keys)
    with pytest.raises(OutputError, match=rf"uncertainty\.json · settings lack {keys[-1]}"):
        export_ply(world.out, colour="epistemic", network=world.network)
