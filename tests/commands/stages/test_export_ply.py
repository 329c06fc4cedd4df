# SPDX-License-Identifier: MIT
import json
from dataclasses import replace

import numpy as np
import plyfile
import pytest
from scans import SMALL, files_below, refused, write_array, write_bin
from world import Stored, begin_and_end

from salsanext_cli import LabelSpace, Scan, label_space, read_labels, read_scan, write_labels
from salsanext_cli.commands.stages.export_ply import export_ply
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.commands.stages.uncertainty import uncertainty
from salsanext_cli.core.errors import LabelError, NoInputError, OutputError
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.report.colours import EMPTY, RIGHT, WRONG, map_colours
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.results.manifest import Manifest, StageRecord
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_selection import ScanSelection

SPACE = label_space()
OVERWRITE = RunOptions(overwrite=True)
FEW = UncertaintyMethod(samples=2)
KINDS = (*FEW.kinds, "least_confidence")


def sample(world):
    predict_scans(world.data, world.out, settings=world.network)
    uncertainty(world.data, world.out, settings=world.network, method=FEW)


@pytest.fixture(scope="module")
def once_sampled(tmp_path_factory, weights):
    return Stored(tmp_path_factory.mktemp("sampled"), weights, sample)


@pytest.fixture
def sampled(once_sampled):
    """Return a world with predictions and uncertainties."""
    return once_sampled.restored()


def export(world, **options):
    return export_ply(world.out, **options)


def ply(world, sequence="08", stem="000000", folder="ply"):
    place = world.result("ply", sequence, stem).parents[1]
    return plyfile.PlyData.read(place / folder / f"{stem}.ply")


def codes(outcome):
    return [failure.code for failure in outcome.failures]


def column(world, name, *where):
    prefix = "" if name in ("x", "y", "z", "red", "green", "blue") else "scalar_"
    return np.array(ply(world, *where)["vertex"][prefix + name])


def colours(world, *where):
    return np.stack([column(world, name, *where) for name in ("red", "green", "blue")], axis=1)


def test_every_scalar_is_a_property(sampled):
    assert export(sampled).done == 3
    data = ply(sampled)
    assert not data.text
    assert data.byte_order == "<"
    names = [p.name for p in data["vertex"].properties]
    assert names[:6] == ["x", "y", "z", "red", "green", "blue"]
    scalars = ["label", "intensity", "range", "truth", "wrong"]
    assert names[6:11] == [f"scalar_{name}" for name in scalars]
    assert set(names[11:]) == {f"scalar_{kind}" for kind in KINDS}
    scan = read_scan(sampled.scan())
    for axis, values in zip("xyz", scan.points.T, strict=True):
        np.testing.assert_array_equal(column(sampled, axis), values)
    np.testing.assert_array_equal(column(sampled, "intensity"), scan.intensity)
    np.testing.assert_array_equal(column(sampled, "label"), sampled.labels())
    truth = read_labels(sampled.data / "sequences/08/labels/000000.label")
    np.testing.assert_array_equal(column(sampled, "truth"), truth)
    for kind in KINDS:
        stored = np.load(sampled.result(f"uncertainty/{kind}"))
        np.testing.assert_array_equal(column(sampled, kind), stored)


def test_clouds_hold_the_numbers_of_objects(world):
    predict_scans(world.data, world.out, settings=world.network, extras=("objects",))
    path = world.result("predictions")
    raw = np.fromfile(path, "<u4")
    raw[:5] = raw[:5] & 0xFFFF | np.array([0, 1, 2, 2, 65535], np.uint32) << 16
    raw.tofile(path)
    export(world)
    np.testing.assert_array_equal(column(world, "instance"), raw >> 16)
    # The other scans have the property, too, whatever was found.
    assert "scalar_instance" in [p.name for p in ply(world, "00")["vertex"].properties]
    np.testing.assert_array_equal(column(world, "label"), raw & 0xFFFF)


def test_labels_and_truth_take_the_colours_of_the_label_space(predicted):
    export(predicted, colour="label")
    ids = SPACE.to_train(predicted.labels())
    np.testing.assert_array_equal(colours(predicted), SPACE.colours[ids])
    assert "colour label" in ply(predicted).comments
    export(predicted, colour="truth")
    truth = SPACE.to_train(read_labels(predicted.data / "sequences/08/labels/000000.label"))
    drawn = colours(predicted, "08", "000000", "ply/truth")
    np.testing.assert_array_equal(drawn, SPACE.colours[truth])


def test_values_use_a_uniform_colour_map_and_record_its_range(sampled):
    export(sampled, colour="entropy")
    values = column(sampled, "entropy").astype(np.float64)
    (comment,) = [c for c in ply(sampled).comments if c.startswith("colour")]
    # CloudCompare shows the first scalar.
    assert ply(sampled)["vertex"].properties[6].name == "scalar_entropy"
    _, name, cmap, low, high = comment.split()
    assert (name, cmap) == ("entropy", "viridis")
    low, high = float(low), float(high)
    assert low < high
    share = np.clip((values - low) / (high - low), 0, 1)
    nearest = map_colours("viridis")[np.rint(share * 255).astype(int)].astype(int)
    assert np.abs(colours(sampled) - nearest).max() <= 3
    recorded = json.loads((sampled.out / "export-ply.json").read_text())["settings"]["scale"]
    assert recorded == pytest.approx([low, high], rel=1e-5)


def test_a_scale_may_be_given(predicted):
    export(predicted, colour="range", scale=(0, 10))
    assert "colour range viridis 0 10" in ply(predicted).comments
    far = column(predicted, "range") >= 10
    assert (colours(predicted)[far] == map_colours("viridis")[-1]).all()
    with refused(OutputError, predicted.out / "export-ply.json"):
        export(predicted, colour="range", scale=(0, 20))
    assert export(predicted, colour="range", scale=(0, 20), options=OVERWRITE).done == 3


def test_uncertainty_is_the_confidence_until_another_kind_is_known(predicted):
    one = ScanSelection(limit=1)
    assert export(predicted, colour="uncertainty", query=ResultQuery(selection=one)).done == 1
    assert ply(predicted, "00").comments[0].startswith("colour least_confidence viridis ")
    with pytest.raises(NoInputError) as caught:
        export(predicted, colour="entropy")
    assert f"`salsanext uncertainty '{predicted.data}' " in caught.value.hint
    uncertainty(
        *(predicted.data, predicted.out),
        settings=predicted.network,
        method=replace(FEW, aleatoric="none"),
        selection=one,
    )
    outcome = export(predicted, colour="uncertainty")
    assert (outcome.done, codes(outcome)) == (1, ["no-input"] * 2)
    for path in predicted.out.rglob("uncertainty/*/*.npy"):
        path.unlink()
    with pytest.raises(NoInputError):
        export(predicted, colour="least_confidence")


def test_without_labels_there_is_neither_truth_nor_wrong(predicted):
    for path in predicted.data.rglob("*.label"):
        path.unlink()
    for colour in ("truth", "wrong"):
        with pytest.raises(NoInputError) as caught:
            export(predicted, colour=colour)
        assert caught.value.expected.endswith("000000.label")
    assert export(predicted).done == 3
    assert "scalar_truth" not in [p.name for p in ply(predicted)["vertex"].properties]


def test_one_scan_without_labels_or_predictions_fails_alone(predicted):
    (predicted.data / "sequences/08/labels/000001.label").unlink()
    outcome = export(predicted, colour="wrong")
    assert (outcome.done, codes(outcome)) == (2, ["no-input"])
    # Train ids instead of raw ids
    path = predicted.data / "sequences/00/labels/000000.label"
    write_labels(path, SPACE.to_train(read_labels(path)).astype(np.uint32))
    predicted.result("predictions", "08", "000001").unlink()
    outcome = export(predicted, options=OVERWRITE)
    assert (outcome.done, codes(outcome)) == (1, ["label"])


def test_several_colourings_have_a_folder_each(predicted):
    first = {"colour": "range", "scale": (0, 10)}
    assert export(predicted, **first).done == 3
    before = files_below(predicted.out)
    for colour in ("label", "wrong"):
        assert export(predicted, colour=colour).done == 3
    assert export(predicted, **first).skipped == 3
    after = files_below(predicted.out)
    assert before.items() <= after.items()
    assert export(predicted, colour="label", options=OVERWRITE).done == 3
    assert files_below(predicted.out) == after
    comments = [ply(predicted, folder=f"ply/{c}").comments[0] for c in ("label", "wrong")]
    assert comments == ["colour label", "colour wrong"]
    assert ply(predicted).comments[0] == "colour range viridis 0 10"


def test_an_edited_cloud_is_not_replaced(predicted):
    export(predicted, colour="range")
    export(predicted)
    mine = predicted.result("ply").parent / "label/000000.ply"
    mine.write_bytes(mine.read_bytes() + b"mine")
    edited = mine.read_bytes()
    uncertainty(predicted.data, predicted.out, settings=predicted.network, method=FEW)
    outcome = export(predicted)
    assert (outcome.done, codes(outcome)) == (2, ["output"])
    assert mine.read_bytes() == edited
    # The other clouds are written again with the newer uncertainty.
    names = [p.name for p in ply(predicted, stem="000001", folder="ply/label")["vertex"].properties]
    assert "scalar_epistemic" in names


def test_odd_points_are_exported(world):
    points = np.array([[0, 0, 0], [np.nan, 1, 1], [5, 0, 0], [np.inf, 0, 0]], np.float32)
    write_bin(world.scan(), Scan(points, np.array([0, np.nan, 1, np.inf], np.float32)))
    write_labels(world.data / "sequences/08/labels/000000.label", np.zeros(4, np.uint32))
    predict_scans(world.scan(), world.out, settings=world.network)
    assert export(world, colour="least_confidence").done == 1
    np.testing.assert_array_equal(colours(world)[[0, 1, 3]], np.tile(EMPTY, (3, 1)))
    assert np.isnan(column(world, "least_confidence")[[0, 1, 3]]).all()


@pytest.mark.usefixtures("workers_in_process")
def test_a_continued_run_keeps_its_scale(predicted):
    export(predicted, colour="range", query=ResultQuery(selection=ScanSelection(limit=1)))
    export(predicted, colour="range", options=RunOptions(jobs=2))
    (comment,) = {ply(predicted, s).comments[0] for s in ("00", "08")}
    low, high = (float(n) for n in comment.split()[-2:])
    ranges = column(predicted, "range")
    assert ((ranges >= low) & (ranges <= high)).mean() > 0.95


CAR, COUNT = 10, 1500
SCANS = (("00", "000000"), ("08", "000000"), ("08", "000001"))
ERROR = np.linspace(0, 1, COUNT, dtype=np.float32)
ERROR[::100] = np.nan


@pytest.fixture
def known(world, monkeypatch):
    """Return a world of labels and probabilities of error of unknown origin."""
    monkeypatch.setenv("SALSANEXT_DATASET", str(world.data))
    world.predict_by_hand(CAR)
    for scan in SCANS:
        write_array(world.result("uncertainty/error", *scan), ERROR)
    return world


def truth_of(world):
    return SPACE.to_train(read_labels(world.data / "sequences/08/labels/000000.label"))


def test_error_is_the_first_choice_of_uncertainty(known):
    assert export(known, colour="uncertainty").done == 3
    assert ply(known).comments[0] == "colour error viridis 0 0.02 0.05 0.1 0.2 0.5 1"
    np.testing.assert_array_equal(column(known, "error"), ERROR)
    wrong, counts = truth_of(known) != SPACE.names.index("car"), SPACE.scored[truth_of(known)]
    np.testing.assert_array_equal(column(known, "wrong"), np.where(counts, wrong, np.nan))
    assert export(known, colour="error").skipped == 3


def test_rejected_points_are_neither_right_nor_wrong(known):
    """The run rejected the points of the labels that are 0."""
    settings = {"label_space": SPACE.to_dict(), "sensor": SMALL.to_dict(), "reject": 0.5}
    Manifest(known.out).write(
        StageRecord(stage="predict", settings=settings, writes=("predictions",))
    )
    above, truth = ERROR > 0.5, truth_of(known)
    write_labels(known.result("predictions"), np.where(above, 0, CAR).astype(np.uint32))
    export(known, colour="wrong")
    wrong = column(known, "wrong")
    assert np.isnan(wrong[above]).all()
    accepted = ~above & SPACE.scored[truth]
    car = truth == SPACE.names.index("car")
    np.testing.assert_array_equal(wrong[accepted], ~car[accepted])
    for colour, points in ((EMPTY, ~accepted), (RIGHT, accepted & car), (WRONG, accepted & ~car)):
        assert points.any()
        assert (colours(known)[points] == colour).all()
    share, risk = accepted.sum() / SPACE.scored[truth].sum(), 1 - car[accepted].mean()
    assert f"coverage {share:.1%}, risk {risk:.1%}".replace("%", " %") in ply(known).comments


def test_errors_of_other_weights_than_the_labels_are_refused(known):
    settings = {"label_space": SPACE.to_dict(), "sensor": SMALL.to_dict()}
    for stage, folder, weights in (
        ("predict", "predictions", "a"),
        ("uncertainty", "uncertainty/error", "b"),
    ):
        recorded = settings | {"weights": weights * 64}
        begin_and_end(known.out, stage, recorded, [folder], overwrite=True)
    refused(OutputError, known.out, export, known, colour="error")


def test_other_classes_than_those_predicted_are_refused(predicted):
    small = {"labels": {0: "no", 1: "yes"}, "learning_map": {0: 0, 1: 1}}
    two = LabelSpace.from_dict(small | {"learning_map_inv": {0: 0, 1: 1}, "name": "two"})
    with pytest.raises(LabelError):
        export(predicted, query=ResultQuery(label_space=two))
    with pytest.raises(LabelError):
        ResultFolder(predicted.out).predicted(ScanSelection(), space=two)
