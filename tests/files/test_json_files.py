# SPDX-License-Identifier: MIT
import json
from functools import partial, reduce
from pathlib import Path

import pytest
from world import Kept

from salsanext_cli.errors import OutputError
from salsanext_cli.files.json_files import RecordedSettings
from salsanext_cli.options import ScanSelection
from salsanext_cli.stages.export_ply import export_ply
from salsanext_cli.stages.picture import picture
from salsanext_cli.stages.predict import predict_range_images, predict_scans
from salsanext_cli.stages.project import project_scans

SETTINGS = RecordedSettings(
    {"n": 3, "endless": "Infinity", "marks": [1, 2.5, 4], "in": {"k": 5}},
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
    assert SETTINGS.numbers("marks") == (1.0, 2.5, 4.0)
    assert SETTINGS.table("in")["k"] == 5
    assert SETTINGS.get("none") is None


@pytest.mark.parametrize("read", ["numbers", "table", "__getitem__"])
def test_what_was_cut_out_is_named(read):
    with pytest.raises(OutputError, match=r"out/predict\.json · settings lack none · .*delete it"):
        getattr(SETTINGS, read)("none")
    with pytest.raises(OutputError, match=r"out/predict\.json · settings lack none"):
        SETTINGS.table("in")["none"]


@pytest.mark.parametrize(
    ("read", "key"),
    [
        *(("numbers", key) for key in ("n", "endless", "in")),
        *(("table", key) for key in ("n", "marks", "endless")),
    ],
)
def test_what_was_put_in_is_named(read, key):
    with pytest.raises(OutputError, match=rf"out/predict\.json · settings have {key} "):
        getattr(SETTINGS, read)(key)


def fill(world):
    """Leave records of most stages in the output folder of a world."""
    first = {"settings": world.network, "selection": ScanSelection(limit=1)}
    sensor = world.network.load().sensor
    project_scans(world.data, world.out, sensor=sensor, selection=first["selection"])
    predict_scans(world.data, world.out, **first)
    export_ply(world.out, colour="range")
    picture(world.out, colours=["range"])


@pytest.fixture(scope="session")
def once_filled(tmp_path_factory, weights):
    return Kept(tmp_path_factory.mktemp("filled"), weights, fill)


@pytest.fixture
def filled(once_filled):
    return once_filled.anew()


@pytest.mark.parametrize(
    ("stage", "keys", "value"),
    [
        *(("export-ply", ["scale"], scale) for scale in (None, 3, [1], ["a", "b"])),
        *(("predict", [key], None) for key in ("label_space", "sensor")),
        *(("picture", ["scales"], scales) for scales in (None, 3)),
        *(("picture", ["scales", "range"], scale) for scale in (3, [1], ["a", "b"])),
        ("predict", ["label_space"], 7),
        ("project", ["sensor"], None),
    ],
)
def test_a_stage_names_the_record_and_what_it_lacks(filled, stage, keys, value):
    change(filled.out / f"{stage}.json", *keys, to=value)
    run = partial(export_ply, filled.out, colour="label")
    if stage == "project":
        run = partial(predict_range_images, filled.out, filled.out, settings=filled.network)
    elif stage == "picture":
        run = partial(picture, filled.out, colours=["range"])
    elif stage == "export-ply":
        run = partial(export_ply, filled.out, colour="range")
    with pytest.raises(OutputError, match=rf"{stage}\.json · settings (lack|have) {keys[-1]}"):
        run()
