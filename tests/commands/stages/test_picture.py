# SPDX-License-Identifier: MIT
import json
from io import BytesIO

import numpy as np
import pytest
from matplotlib.image import imread
from PIL import Image
from scans import files_below, make_scan, refused, write_array, write_bin

from salsanext_cli import Scan, label_space, write_ply
from salsanext_cli.commands.jobs import picture_task as task
from salsanext_cli.commands.stages.picture import picture, picture_scans
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.errors import NoInputError, OutputError, UsageError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.report import scan_pictures
from salsanext_cli.report.colours import WRONG, screen_colours
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.scans.scan_selection import ScanSelection

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

    monkeypatch.setattr(task, "picture_of_results", picture)


@pytest.fixture
def labelled(world):
    """Return a world with the label car for all points, without a record of `predict`."""
    world.predict_by_hand(CAR)
    return world


def draw(world, selection=ScanSelection(), **options):
    return picture(world.out, query=ResultQuery(world.data, selection), **options)


def pngs(world):
    return {name: png for name, png in files_below(world.out).items() if name.endswith(".png")}


def pixels(path):
    return (imread(path)[..., :3] * 255).round().astype(int)


def drawn(world, sequence="00", stem="000000"):
    return pixels(world.result("pictures", sequence, stem))


def has(picture, colour):
    return (picture == np.array(colour)).all(axis=-1).sum() > 100


def class_colour(raw):
    return screen_colours(SPACE)[SPACE.to_train(np.array([raw], np.uint32))[0]]


def test_a_picture_of_every_scan_with_results(labelled):
    outcome = draw(labelled, colours=["label"])
    assert (outcome.done, outcome.failures) == (3, ())
    assert sorted(pngs(labelled)) == [
        "sequences/00/pictures/000000.png",
        "sequences/08/pictures/000000.png",
        "sequences/08/pictures/000001.png",
    ]
    label = drawn(labelled)
    assert has(label, class_colour(CAR))
    assert not has(label, class_colour(ROAD))
    draw(labelled, colours=["label", "wrong", "label"], options=OVERWRITE, selection=ONE)
    assert has(drawn(labelled), WRONG)
    assert not has(drawn(labelled), class_colour(ROAD))
    height = drawn(labelled).shape[0]
    draw(labelled, options=OVERWRITE, selection=ONE)
    everything = drawn(labelled)
    assert everything.shape[0] > height
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


@pytest.fixture
def alone(tmp_path):
    """Return a function that writes a scan without labels, in the format of a suffix."""

    def write(name, points):
        path = tmp_path / "unknown" / name
        intensity = np.linspace(0, 1, len(points), dtype=np.float32)
        write_scan(path, points, intensity)
        return path

    return write


def write_scan(path, points, intensity):
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".ply":
        columns = dict(zip("xyz", points.T, strict=True)) | {"intensity": intensity}
        write_ply(path, columns)
    else:
        write_bin(path, Scan(points, intensity))


@pytest.mark.parametrize("name", ["scan.bin", "scan.ply"])
def test_an_unknown_file_is_drawn_by_height_and_intensity(alone, tmp_path, name):
    points = make_scan().points.copy()
    points[:50] = 0  # Without a measurement
    out = tmp_path / "out"
    outcome = picture_scans(alone(name, points), out)
    assert (outcome.done, outcome.failures) == (1, ())
    assert [*files_below(out)].count("sequences/unknown/pictures/scan.png") == 1
    assert outcome.first == out / "sequences/unknown/pictures/scan.png"
    heights = points[50:, 2]
    assert outcome.scales["height"] == pytest.approx(np.percentile(heights, (1, 99)), abs=1e-4)
    assert set(outcome.scales) == {"height", "intensity", "range"}


@pytest.mark.usefixtures("plain")
def test_all_pictures_of_a_folder_have_one_scale(alone, tmp_path, caplog):
    out, unfitted = tmp_path / "out", NetworkSettings(fit=False)
    near = alone("near.bin", make_scan().points)
    far = alone("far.bin", 4 * make_scan().points)

    def drawn_in_out(path, **changes):
        return picture_scans(path, out, settings=unfitted, **changes)

    like = alone("like.bin", 1.1 * make_scan().points)
    scales = [drawn_in_out(path).scales for path in (near, like)]
    assert scales[1] == scales[0]
    assert not [record for record in caplog.records if record.levelname == "WARNING"]
    assert drawn_in_out(far).scales == scales[0]
    warnings = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    colours = [text.removeprefix(f"{out}: ").partition(" of these scans")[0] for text in warnings]
    assert colours == ["height", "range"]
    assert [drawn_in_out(path).skipped for path in (near, like, far)] == [1, 1, 1]
    with refused(OutputError, out / "picture.json"):
        drawn_in_out(near, scale=(0, 1), colours=["height"])
    redrawn = drawn_in_out(far, options=OVERWRITE).scales["height"]
    assert redrawn == pytest.approx(4 * np.array(scales[0]["height"]), rel=1e-5)


@pytest.mark.usefixtures("plain")
def test_a_scale_is_recorded_when_its_value_first_varies(tmp_path):
    points = make_scan().points
    intensities = {"without": 0 * points[:, 0], "low": points[:, 0] ** 2, "high": points[:, 1] ** 4}
    for name, intensity in intensities.items():
        write_scan(tmp_path / f"scans/{name}.bin", points, intensity)
    record = tmp_path / "out/picture.json"
    outcomes = {}
    for name in intensities:
        outcomes[name] = picture_scans(tmp_path / f"scans/{name}.bin", tmp_path / "out")
        if name == "without":
            # Older versions recorded a scale here.
            height = '"height": ['
            text = record.read_text()
            assert height in text
            record.write_text(text.replace(height, f'"intensity": [0, 0], {height}'))
    assert "intensity" not in outcomes["without"].scales
    assert outcomes["without"].ranges["intensity"] == (0, 0)
    ends = {name: np.percentile(values, (1, 99)) for name, values in intensities.items()}
    for name in ("low", "high"):
        assert outcomes[name].scales["intensity"] == pytest.approx(ends["low"], rel=1e-5)
        assert outcomes[name].ranges["intensity"] == pytest.approx(ends[name], rel=1e-5)
    recorded = json.loads(record.read_text())["settings"]["scales"]
    assert recorded == {name: [*scale] for name, scale in outcomes["high"].scales.items()}


@pytest.mark.usefixtures("plain")
def test_a_further_value_extends_the_scales_of_a_folder(labelled):
    draw(labelled, selection=ONE)
    path = labelled.result("uncertainty/entropy", "08", "000001")
    write_array(path, np.linspace(0, 1, 1500, dtype=np.float32))
    before = json.loads((labelled.out / "picture.json").read_text())["settings"]["scales"]
    assert draw(labelled, selection=TWO).done == 2
    after = json.loads((labelled.out / "picture.json").read_text())["settings"]["scales"]
    assert after == before | {"entropy": pytest.approx([0.01, 0.99], abs=0.002)}


@pytest.mark.usefixtures("plain")
def test_scans_that_have_pictures_are_not_read_for_scales(alone, tmp_path, monkeypatch):
    paths = [alone(name, make_scan().points) for name in ("a.bin", "b.bin")]
    picture_scans(paths[0], tmp_path / "out")
    measured = []
    of_scans = task.common_scales

    def noted(out, scans, *arguments):
        measured.append([scan.stem for scan in scans])
        return of_scans(out, scans, *arguments)

    monkeypatch.setattr(task, "common_scales", noted)
    for scans in (paths, paths):
        picture_scans(scans, tmp_path / "out")
    assert measured == [["b"], []]


@pytest.mark.usefixtures("plain")
def test_scans_have_the_sensor_that_is_requested(alone, tmp_path):
    path = alone("scan.bin", make_scan().points)
    narrow = NetworkSettings(width=256)
    assert picture_scans(path, tmp_path / "narrow", settings=narrow).sensor.width == 256
    moved = picture_scans(path, tmp_path / "moved", origin=(0.5, 0.0, -1.0))
    assert moved.sensor.origin == (0.5, 0.0, -1.0)
    low, high = moved.scales["height"]
    heights = make_scan().points[:, 2] + 1
    assert (low, high) == pytest.approx(np.percentile(heights, (1, 99)), abs=1e-4)


@pytest.mark.usefixtures("plain")
def test_pictures_of_scans_stay_until_there_are_results(world):
    assert picture_scans(world.data, world.out).done == 3
    assert picture_scans(world.data, world.out).skipped == 3
    refused(
        OutputError,
        world.out / "picture.json",
        picture_scans,
        world.data,
        world.out,
        colours=["height"],
    )
    # A later `predict` makes them outdated.
    predict_scans(world.data, world.out, settings=world.network)
    assert picture(world.out).done == 3


def test_the_truth_of_scans_is_drawn_if_there_is_any(world, tmp_path):
    with_truth = picture_scans(world.data, tmp_path / "with", query=ResultQuery(None, ONE))
    assert has(pixels(with_truth.first), class_colour(CAR))
    for path in world.data.rglob("*.label"):
        path.unlink()
    without = picture_scans(world.data, tmp_path / "without", query=ResultQuery(None, ONE))
    assert not has(pixels(without.first), class_colour(CAR))
    assert pixels(without.first).shape[0] < pixels(with_truth.first).shape[0]
    with refused(NoInputError, world.scan("00")):
        picture_scans(world.data, tmp_path / "truth", colours=["truth"])


def test_scans_that_cannot_be_read_fail_alone(alone, tmp_path):
    alone("b.bin", make_scan().points)
    (tmp_path / "unknown/a.bin").write_bytes(b"12345")
    outcome = picture_scans(tmp_path / "unknown", tmp_path / "out")
    assert (outcome.done, [failure.code for failure in outcome.failures]) == (1, ["format"])
    with refused(NoInputError, tmp_path / "nowhere"):
        picture_scans(tmp_path / "nowhere", tmp_path / "out")
    with refused(UsageError, "colours"):
        picture_scans(tmp_path / "unknown", tmp_path / "out", colours=["heights"])
