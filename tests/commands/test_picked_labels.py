# SPDX-License-Identifier: MIT
"""Results of picked scans: they are written into the data set, and pre-labels are no truth."""

import logging

import numpy as np
import pytest
from scans import write_array, write_sequence

from salsanext_cli import read_labels, write_labels
from salsanext_cli.commands.picked_labels import doubtful_share, label_picked_scans
from salsanext_cli.commands.stages.pick import pick
from salsanext_cli.commands.stages.report import read_run
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.scans.scan_search import find_scans


@pytest.fixture
def to_label(world, monkeypatch):
    """Return a data set with pre-labels of two scans of a drive, and the world."""
    monkeypatch.setattr("salsanext_cli.commands.stages.pick.SAMPLES", 2)
    write_sequence(world.data / "sequences/08", ["000000", "000001", "000002"], labels=False)
    pick(world.data, world.out, count=2, settings=world.network)
    return world


def test_pre_labels_are_not_compared_until_somebody_changed_them(to_label):
    labels = label_picked_scans(to_label.out, to_label.network, RunOptions())
    scans = find_scans(to_label.out)
    assert (labels.folder, labels.failures) == (to_label.out / "predicted", ())
    run, _ = read_run(labels.folder, query=ResultQuery(), options=RunOptions())
    assert [row.file.name for row in run.rows] == [scan.name for scan in scans]
    assert run.counts is None
    assert run.read(run.rows[0]).results.truth is None
    changed = read_labels(scans[0].label_path)
    changed[:5] = 10
    changed[5:9] = 40
    write_labels(scans[0].label_path, changed)
    run, _ = read_run(labels.folder, query=ResultQuery(), options=RunOptions())
    assert run.counts.scans == 1
    assert run.read(run.rows[0]).results.truth is not None
    assert run.read(run.rows[1]).results.truth is None


def test_the_choice_has_printed_the_warnings_and_the_level_of_the_log_is_restored(to_label, caplog):
    log = logging.getLogger("salsanext_cli")
    before = log.level
    caplog.clear()
    label_picked_scans(to_label.out, to_label.network, RunOptions())
    assert not [record for record in caplog.records if record.levelno < logging.ERROR]
    assert log.level == before


def test_results_of_an_earlier_choice_are_replaced_with_it(to_label):
    label_picked_scans(to_label.out, to_label.network, RunOptions())
    replace = RunOptions(overwrite=True)
    pick(to_label.data, to_label.out, count=1, settings=to_label.network, options=replace)
    labels = label_picked_scans(to_label.out, to_label.network, replace)
    predicted = sorted(path.stem for path in labels.folder.glob("sequences/*/predictions/*.label"))
    assert predicted == [scan.stem for scan in find_scans(to_label.out)]


def test_points_above_a_tenth_are_doubtful(tmp_path):
    assert doubtful_share(tmp_path) is None
    errors = ([0.05, 0.1, 0.2, np.nan], [0.5, 0.09])
    for number, values in enumerate(errors):
        path = tmp_path / f"sequences/00/uncertainty/error/00000{number}.npy"
        write_array(path, np.array(values, np.float32))
    known = [value for values in errors for value in values if not np.isnan(value)]
    assert doubtful_share(tmp_path) == sum(value > 0.1 for value in known) / len(known)
