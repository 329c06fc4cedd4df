# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from salsanext_cli import label_space
from salsanext_cli.commands.stages.evaluate import evaluate_scans
from salsanext_cli.commands.stages.picture import picture
from salsanext_cli.commands.stages.report import report
from salsanext_cli.core.errors import NoInputError
from salsanext_cli.io.formats.kitti_labels import write_labels
from salsanext_cli.runs.annotation.foreign_labels import warn_of_foreign_labels
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.scans.scan_search import find_scans

CAR = 10
OF_ANOTHER_SPACE = 24  # An id of nuScenes without a meaning in SemanticKITTI
SPACE = label_space()


@pytest.fixture
def labelled(world):
    """Return a world whose data set and results have the label car."""
    world.predict_by_hand(CAR)
    for scan in find_scans(world.data):
        write_labels(scan.label_path, np.full(1500, CAR, np.uint32))
    return world


def relabel(world, *, count):
    """Give the first scans labels of another label space."""
    for scan in find_scans(world.data)[:count]:
        write_labels(scan.label_path, np.full(1500, OF_ANOTHER_SPACE, np.uint32))


@pytest.mark.parametrize(("count", "are_foreign"), [(0, False), (1, False), (3, True)])
def test_labels_are_foreign_if_no_file_can_be_mapped(labelled, caplog, count, are_foreign):
    relabel(labelled, count=count)
    scans = find_scans(labelled.data)
    assert warn_of_foreign_labels(scans, SPACE, None) is are_foreign
    assert [record.message.count(str(scans[0].label_path)) for record in caplog.records] == (
        [1] if are_foreign else []
    )


def test_scans_without_labels_have_no_foreign_ones(world):
    assert not warn_of_foreign_labels(find_scans(world.data), SPACE, None)


@pytest.mark.usefixtures("undrawn")
def test_results_are_shown_without_foreign_labels(labelled):
    relabel(labelled, count=3)
    query = ResultQuery(labelled.data)
    outcome = picture(labelled.out, query=query)
    assert (outcome.done, outcome.failures) == (3, ())
    shown = report(labelled.out, query=query).to_dict()
    assert (shown["scans"], shown["accuracy"]) == (3, None)


@pytest.mark.usefixtures("undrawn")
def test_who_asks_for_the_truth_is_refused(labelled):
    relabel(labelled, count=3)
    query = ResultQuery(labelled.data)
    outcome = picture(labelled.out, query=query, colours=["truth"])
    assert [failure.code for failure in outcome.failures] == ["label"] * 3
    scans = find_scans(labelled.data)
    with pytest.raises(NoInputError):
        evaluate_scans(scans, labelled.out, SPACE)
