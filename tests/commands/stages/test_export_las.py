# SPDX-License-Identifier: MIT
"""LAS clouds of labelled scans, opened again by laspy."""

import numpy as np
import pytest
from las_files import write_las
from scans import files_below, make_scan, refused

from salsanext_cli import label_space, read_labels, write_labels
from salsanext_cli.commands.stages.export_las import export_las
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.errors import NoInputError, OutputError
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.results.query import ResultQuery

laspy = pytest.importorskip("laspy")
SPACE = label_space()
COARSE = label_space("coarse")


def cloud(world, folder="las", stem="000000"):
    return laspy.read(world.result(folder, "08", stem))


@pytest.fixture
def predicted(world):
    world.predict()
    return world


def test_every_value_is_a_dimension_and_the_classification_has_codes(predicted):
    assert export_las(predicted.out).done == 3
    las = cloud(predicted)
    labels = predicted.labels()
    np.testing.assert_array_equal(las["label"], labels & 0xFFFF)
    codes = SPACE.asprs_codes
    np.testing.assert_array_equal(las.classification, [codes[i] for i in labels.tolist()])
    extra = set(las.point_format.extra_dimension_names)
    assert extra == {"label", "truth", "wrong", "range", "least_confidence"}


def test_a_second_run_does_nothing_until_the_labels_change(predicted):
    export_las(predicted.out)
    before = files_below(predicted.out)
    assert export_las(predicted.out).skipped == 3
    assert files_below(predicted.out) == before
    export_las(predicted.out, compressed=True)
    assert cloud(predicted, "laz").header.are_points_compressed
    np.testing.assert_array_equal(
        cloud(predicted, "laz").classification, cloud(predicted).classification
    )
    las = predicted.result("las")
    las.write_bytes(b"mine")
    outcome = export_las(predicted.out, options=RunOptions(overwrite=True))
    assert [failure.code for failure in outcome.failures] == [OutputError.code]
    assert las.read_bytes() == b"mine"


def test_merged_classes_have_their_codes(predicted):
    export_las(predicted.out, query=ResultQuery(classes=COARSE))
    labels = COARSE.to_raw(COARSE.to_train(predicted.labels()))
    codes = COARSE.asprs_codes
    np.testing.assert_array_equal(
        cloud(predicted).classification, [codes[i] for i in labels.tolist()]
    )


def test_las_scans_in_a_map_keep_their_coordinates(tmp_path, world):
    points = make_scan(1500).points + np.array([500_123.4, 5_400_456.7, 312.0])
    path = write_las(tmp_path / "drive/000000.laz", points, offsets=(5e5, 5.4e6, 0), kind=1)
    out = tmp_path / "results"
    assert predict_scans(path.parent, out, settings=world.network).failures == ()
    assert export_las(out).done == 1
    las = laspy.read(out / "sequences/drive/las/000000.las")
    own = laspy.read(path)
    for name in "XYZ":
        np.testing.assert_array_equal(las[name], own[name])
    np.testing.assert_array_equal(
        las["label"], read_labels(out / "sequences/drive/predictions/000000.label")
    )


def test_scans_without_labels_are_refused(tmp_path, world):
    with refused(NoInputError, world.out):
        export_las(world.out)
    world.predict()
    world.result("predictions").unlink()
    outcome = export_las(world.out)
    assert (outcome.done, len(outcome.missing.scans)) == (2, 1)
    write_labels(world.result("predictions"), np.zeros(3, np.uint32))
    outcome = export_las(world.out, options=RunOptions(overwrite=True))
    assert len(outcome.failures) == 1
