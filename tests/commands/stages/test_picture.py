# SPDX-License-Identifier: MIT
import json
from io import BytesIO

import numpy as np
import pytest
from matplotlib.image import imread
from PIL import Image
from scans import files_below, refused, write_array

from salsanext_cli import label_space
from salsanext_cli.commands.stages import picture as stage
from salsanext_cli.commands.stages.picture import picture
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.report import scan_pictures
from salsanext_cli.report.colours import WRONG, screen_colours
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.scan_selection import ScanSelection

pytestmark = pytest.mark.drawn
OVERWRITE = RunOptions(overwrite=True)
ONE, TWO = ScanSelection(sequences=("00",)), ScanSelection(sequences=("08",))
SPACE = label_space()
CAR, ROAD = 10, 40


@pytest.fixture(autouse=True)
def small_views(monkeypatch):
    """Draw a quarter as large: a second for each picture otherwise."""
    monkeypatch.setattr(scan_pictures, "WIDTH_PX", 512)
    monkeypatch.setattr(scan_pictures, "NARROW_PX", 256)
    monkeypatch.setattr(scan_pictures, "OVERSAMPLING", 1)


@pytest.fixture
def plain(monkeypatch):
    """Draw every picture in one colour, different from the others."""
    greys = iter(range(0, 250, 20))

    def picture(*_, **__):
        png = BytesIO()
        Image.new("L", (32, 32), next(greys)).convert("RGB").save(png, "png")
        return png.getvalue()

    monkeypatch.setattr(stage, "picture_of_results", picture)


@pytest.fixture
def labelled(world):
    """Return a world with the label car for all points, without a record of `predict`."""
    world.predict_by_hand(CAR)
    return world


def draw(world, selection=ScanSelection(), **options):
    return picture(world.out, query=ResultQuery(world.data, selection), **options)


def pngs(world):
    return {name: png for name, png in files_below(world.out).items() if name.endswith(".png")}


def drawn(world, sequence="00", stem="000000"):
    return (imread(world.result("pictures", sequence, stem))[..., :3] * 255).round().astype(int)


def has(picture, colour):
    return (picture == np.array(colour)).all(axis=-1).sum() > 100


def class_colour(raw):
    return screen_colours(SPACE)[SPACE.to_train(np.array([raw], np.uint32))[0]]


def test_a_picture_of_every_scan_with_results(labelled):
    outcome = draw(labelled)
    assert (outcome.done, outcome.failures) == (3, ())
    assert sorted(pngs(labelled)) == [
        "sequences/00/pictures/000000.png",
        "sequences/08/pictures/000000.png",
        "sequences/08/pictures/000001.png",
    ]
    everything = drawn(labelled)
    draw(labelled, colours=["label"], options=OVERWRITE, selection=ONE)
    label = drawn(labelled)
    assert has(label, class_colour(CAR))
    assert not has(label, class_colour(ROAD))
    draw(labelled, colours=["label", "wrong", "label"], options=OVERWRITE, selection=ONE)
    assert has(drawn(labelled), WRONG)
    assert not has(drawn(labelled), class_colour(ROAD))
    assert everything.shape[0] > drawn(labelled).shape[0]
    for colour in (WRONG, class_colour(CAR), class_colour(ROAD)):
        assert has(everything, colour)


@pytest.mark.usefixtures("plain")
def test_pictures_stay_until_results_or_settings_change(predicted):
    world = predicted
    assert picture(world.out).done == 3
    before = pngs(world)
    assert picture(world.out).skipped == 3
    refused(OutputError, world.out / "picture.json", picture, world.out, colours=["range"])
    assert pngs(world) == before
    other = KnnParameters(k=3)
    predict_scans(world.data, world.out, settings=world.network, knn=other, options=OVERWRITE)
    assert picture(world.out).done == 3


def test_values_have_one_scale_for_all_scans_and_runs(labelled):
    for number, (sequence, stem) in enumerate((("00", "000000"), ("08", "000000"))):
        path = labelled.result("uncertainty/entropy", sequence, stem)
        write_array(path, np.linspace(number, number + 1, 1500, dtype=np.float32))
    outcome = draw(labelled, selection=TWO)
    assert (outcome.done, outcome.failures) == (2, ())
    settings = json.loads((labelled.out / "picture.json").read_text())["settings"]
    assert settings["scales"]["entropy"] == pytest.approx([1.01, 1.99], abs=0.002)
    assert set(settings["scales"]) == {"intensity", "range", "entropy"}
    assert draw(labelled).done == 1
    assert json.loads((labelled.out / "picture.json").read_text())["settings"] == settings
    first = drawn(labelled, "08")
    draw(labelled, colours=["uncertainty"], scale=(0, 5), options=OVERWRITE, selection=ONE)
    settings = json.loads((labelled.out / "picture.json").read_text())["settings"]
    assert (settings["colours"], settings["scales"]) == (["entropy"], {"entropy": [0, 5]})
    assert first.shape[0] > drawn(labelled).shape[0]


@pytest.mark.usefixtures("plain")
def test_a_scan_without_a_wanted_colour_fails_alone(labelled):
    write_array(labelled.result("uncertainty/entropy", "00"), np.zeros(1500, np.float32))
    labelled.result("predictions", "08", "000001").unlink()
    outcome = draw(labelled, colours=["entropy"])
    assert (outcome.done, [failure.code for failure in outcome.failures]) == (1, ["no-input"])
    assert [scan.stem for scan in outcome.missing.scans] == ["000001"]
