# SPDX-License-Identifier: MIT
"""Clouds of points whose probability of error is known."""

import json
import shutil

import numpy as np
import plyfile
import pytest
from empty_runs import begin_and_end
from scans import SMALL, write_array

from salsanext_cli import label_space, read_labels
from salsanext_cli.errors import NoInputError, OutputError
from salsanext_cli.parallel.run import RunOptions
from salsanext_cli.report.colours import EMPTY, RIGHT, WRONG
from salsanext_cli.stages.export_ply import export_ply

SPACE = label_space()
SCANS = (("00", "000000"), ("08", "000000"), ("08", "000001"))
CAR, COUNT = 10, 1500
ERROR = np.linspace(0, 1, COUNT, dtype=np.float32)
ERROR[::100] = np.nan


@pytest.fixture
def known(world):
    """Return a world of labels and errors of unknown origin."""
    world.predict_by_hand(CAR)
    for scan in SCANS:
        write_array(world.result("uncertainty/error", *scan), ERROR)
    return world


def export(world, **options):
    return export_ply(world.out, **{"network": world.network, "dataset": world.data, **options})


def cloud(world, folder="ply", sequence="08", stem="000000"):
    path = world.out / "sequences" / sequence / folder / f"{stem}.ply"
    return plyfile.PlyData.read(path)


def column(world, name, *where):
    return np.array(cloud(world, *where)["vertex"][f"scalar_{name}"])


def colours(world, *where):
    vertex = cloud(world, *where)["vertex"]
    return np.stack([vertex[name] for name in ("red", "green", "blue")], axis=1)


def truth_of(world):
    return SPACE.to_train(read_labels(world.data / "sequences/08/labels/000000.label"))


@pytest.mark.parametrize("colour", ["error", "uncertainty"])
def test_error_is_a_colour_and_what_uncertainty_means(known, colour, caplog):
    with caplog.at_level("INFO"):
        assert export(known, colour=colour).done == 3
    assert "coloured by error" in caplog.text
    assert cloud(known).comments[0].startswith("colour error viridis ")
    np.testing.assert_array_equal(column(known, "error"), ERROR)
    wrong, counts = truth_of(known) != SPACE.names.index("car"), SPACE.scored[truth_of(known)]
    np.testing.assert_array_equal(column(known, "wrong"), np.where(counts, wrong, np.nan))
    assert export(known, colour=colour).skipped == 3
    assert not (known.out / "uncertainty.json").exists()


def test_uncertainty_is_the_entropy_where_there_is_no_error(world):
    world.predict_by_hand(CAR)
    for kind in ("epistemic", "entropy", "total"):
        for scan in SCANS:
            write_array(world.result(f"uncertainty/{kind}", *scan), ERROR)
    assert export(world, colour="uncertainty").done == 3
    assert cloud(world).comments[0].startswith("colour entropy viridis ")
    for colour in ("epistemic", "total"):
        assert export(world, colour=colour).done == 3
        assert cloud(world, f"ply/{colour}").comments[0].startswith(f"colour {colour} viridis")


@pytest.mark.parametrize("max_error", [0.0, 0.5])
def test_points_above_the_threshold_are_unlabelled(known, max_error):
    outcome = export(known, max_error=max_error)
    above = max_error < ERROR
    assert outcome.rejected_points == 3 * above.sum()
    expected = np.where(above, 0, CAR)
    np.testing.assert_array_equal(column(known, "label"), expected)
    np.testing.assert_array_equal(colours(known), SPACE.colours[SPACE.to_train(expected)])
    np.testing.assert_array_equal(column(known, "error"), ERROR)
    assert f"unlabelled where error is above {max_error:g}" in cloud(known).comments
    assert set(read_labels(known.result("predictions"))) == {CAR}


def test_rejected_points_are_neither_right_nor_wrong(known):
    above, truth = ERROR > 0.5, truth_of(known)
    export(known, colour="wrong", max_error=0.5)
    wrong = column(known, "wrong")
    assert np.isnan(wrong[above]).all()
    kept = ~above & SPACE.scored[truth]
    car = truth == SPACE.names.index("car")
    np.testing.assert_array_equal(wrong[kept], ~car[kept])
    for colour, points in ((EMPTY, above), (RIGHT, kept & car), (WRONG, kept & ~car)):
        assert points.any()
        assert (colours(known)[points] == colour).all()


def test_another_threshold_does_not_mix_with_the_first(known):
    export(known, max_error=0.5)
    assert export(known, max_error=0.5).skipped == 3
    for other in (0.4, None):
        with pytest.raises(OutputError, match=r"max_error was 0\.5 and is"):
            export(known, max_error=other)
    assert export(known, max_error=0.4, options=RunOptions(overwrite=True)).done == 3
    assert json.loads((known.out / "export-ply.json").read_text())["settings"]["max_error"] == 0.4


def test_a_threshold_without_errors_says_how_to_get_them(known):
    known.result("uncertainty/error", "08", "000001").unlink()
    outcome = export(known, max_error=0.1)
    assert (outcome.done, len(outcome.failures)) == (2, 1)
    assert "no error known" in outcome.failures[0].reason
    for sequence in ("00", "08"):
        shutil.rmtree(known.out / "sequences" / sequence / "uncertainty", ignore_errors=True)
    with pytest.raises(NoInputError, match=r"no error known .* `salsanext tune error`"):
        export(known, max_error=0.1, options=RunOptions(overwrite=True))


@pytest.mark.parametrize(
    ("values", "says"),
    [
        (np.float32([0.5] * 3), r"float32 \(3\)"),
        (np.full(COUNT, 1.5, np.float32), "below 0 or above 1 at 1500 of 1500 points"),
    ],
)
def test_impossible_errors_reject_nothing_and_are_named(known, values, says):
    write_array(known.result("uncertainty/error"), values)
    outcome = export(known, max_error=0.5)
    assert outcome.done == 2
    (failure,) = outcome.failures
    assert failure.code == "format"
    assert str(known.result("uncertainty/error")) in failure.reason
    assert outcome.rejected_points == 2 * (ERROR > 0.5).sum()


def test_errors_of_other_weights_than_the_labels_are_refused(known):
    settings = {"label_space": SPACE.to_dict(), "sensor": SMALL.to_dict()}
    for stage, folder, weights in (
        ("predict", "predictions", "a"),
        ("uncertainty", "uncertainty/error", "b"),
    ):
        recorded = settings | {"weights": weights * 64}
        begin_and_end(known.out, stage, recorded, [folder], overwrite=True)
    for options in ({"colour": "error"}, {"max_error": 0.5}):
        with pytest.raises(OutputError, match=r"labels by the weights aaaa.*uncertainty by bbbb"):
            export(known, **options)
