# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from scans import make_scan, write_array

from salsanext_cli import Scan, label_space
from salsanext_cli.errors import FormatError, LabelError
from salsanext_cli.formats.kitti import write_labels
from salsanext_cli.results.layout import find_scans
from salsanext_cli.results.result_folder import ResultFolder, ScanResults, scalar_columns

SPACE = label_space()
CAR, ROAD, MOVING_CAR = 10, 40, 252


@pytest.fixture
def file(world):
    return next(scan for scan in find_scans(world.data) if scan.sequence == "08")


def test_only_what_is_known(world, file):
    file.label_path.unlink()
    cloud = ResultFolder(world.out).read(file)
    assert cloud.label is None
    assert cloud.truth is None
    assert cloud.uncertainty == {}
    assert set(scalar_columns(cloud, SPACE)) == {"intensity", "range"}
    with pytest.raises(ValueError, match="needs a label and a truth"):
        cloud.wrong(SPACE)


def test_everything_that_is_known(world, file):
    world.predict_by_hand(CAR | 3 << 16)
    for kind in ("entropy", "total"):
        write_array(world.result(f"uncertainty/{kind}"), np.linspace(0, 1, 1500, dtype=np.float32))
    cloud = ResultFolder(world.out).read(file, truth_in=(SPACE, SPACE))
    assert set(scalar_columns(cloud, SPACE)) == {
        *("intensity", "range", "label", "truth", "wrong"),
        *("entropy", "total"),
    }
    assert set(cloud.label) == {CAR}
    np.testing.assert_allclose(cloud.range, np.sqrt((cloud.scan.points**2).sum(1)), rtol=1e-6)


def test_wrong_is_one_zero_or_nothing():
    truth = np.array([CAR, CAR, 0, MOVING_CAR, ROAD], np.uint32)
    label = np.array([CAR, ROAD, CAR, CAR, 0], np.uint32)
    wrong = ScanResults(make_scan(5), label, truth).wrong(SPACE)
    np.testing.assert_array_equal(wrong, np.float32([0, 1, np.nan, 0, 1]), strict=True)


def test_ranges_too_large_for_their_squares():
    points = np.array([[3e30, 4e30, 0], [3e38, 3e38, 3e38], [np.nan, 0, 0]], np.float32)
    distance = ScanResults(Scan(points, np.zeros(3, np.float32))).range
    np.testing.assert_allclose(distance, [5e30, np.inf, np.nan], rtol=1e-6)


def test_files_of_another_scan_are_refused(world, file):
    world.predict_by_hand(count=9)
    with pytest.raises(LabelError, match="9 labels · expected 1,500"):
        ResultFolder(world.out).read(file)
    world.predict_by_hand()
    write_array(world.result("uncertainty/entropy"), np.zeros(3, np.float32))
    with pytest.raises(FormatError, match="entropy"):
        ResultFolder(world.out).read(file)
    write_labels(file.label_path, np.zeros(4, np.uint32))
    with pytest.raises(LabelError, match="4 labels"):
        ResultFolder(world.out).read(file, truth_in=(SPACE, SPACE))
