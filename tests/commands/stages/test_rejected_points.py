# SPDX-License-Identifier: MIT
"""Points that `predict --reject` left unlabelled are neither right nor wrong."""

import numpy as np
import plyfile
import pytest
from calls import calls_of
from evaluation_runs import CAR, ROAD, SPACE, World

from salsanext_cli import sensor
from salsanext_cli.commands.stages.evaluate import evaluate_scans
from salsanext_cli.commands.stages.export_ply import export_ply
from salsanext_cli.commands.stages.picture import picture
from salsanext_cli.commands.stages.report import report, view
from salsanext_cli.report.scan_pictures import scan_picture
from salsanext_cli.runs.results.manifest import Manifest, StageRecord
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.scans.scan_search import find_scans

NONE, TREE = 0, 70
POINTS = (
    # truth, label
    (CAR, CAR),  # right
    (CAR, NONE),  # rejected
    (ROAD, ROAD),  # right
    (ROAD, CAR),  # wrong
    (ROAD, NONE),  # rejected
    (TREE, NONE),  # rejected
    (TREE, NONE),  # rejected
    (TREE, NONE),  # rejected
    (NONE, CAR),  # of an unknown class
    (NONE, NONE),  # of an unknown class
)
TRUTH = [truth for truth, _ in POINTS]
LABELS = [label for _, label in POINTS]
"""Three of eight points of known classes have a label, and one of these is wrong."""


def recorded(world, **settings):
    settings |= {"label_space": SPACE.to_dict(), "sensor": sensor("hdl64").to_dict()}
    Manifest(world.out).write(
        StageRecord(stage="predict", settings=settings, writes=("predictions",))
    )


@pytest.fixture
def world(tmp_path):
    """Return a run that rejected points; scan 1 has no wrong label and the fewest labels."""
    world = World(tmp_path)
    world.add("0", TRUTH, LABELS)
    world.add("1", TRUTH, [CAR] + [NONE] * 9, distance=15)
    recorded(world, reject=0.5)
    return world


@pytest.fixture
def query(world):
    return ResultQuery(world.dataset)


ACCEPTED = 4
"""Of 16 points of known classes in both scans, three of scan 0 and one of scan 1."""


def test_the_report_has_coverage_and_risk_but_no_accuracy(world, query):
    written_report = report(world.out, query=query)
    numbers = written_report.to_dict()
    # One of the accepted labels is wrong.
    assert (numbers["coverage"], numbers["risk"]) == (ACCEPTED / 16, 1 / ACCEPTED)
    assert (numbers["accuracy"], numbers["iou_mean_present"]) == (None, None)
    assert written_report.shown["08/0"].startswith(
        "most wrong (33.3 % of the accepted points with a true class)"
    )


def test_the_page_has_coverage_and_risk_but_no_accuracy(world, query):
    page = report(world.out, query=query).page.read_text()
    assert "<b>25.0 %</b>coverage: accepted of 16 labelled points, 2 scans" in page
    assert "<b>25.0 %</b>risk" in page
    assert "accuracy: right" not in page


def test_rejected_points_are_no_confusions(world, query):
    page = report(world.out, query=query).page.read_text()
    confusions = page.partition("Largest confusions")[2].partition("</ol>")[0]
    items = confusions.partition('class="confusions">')[2].split("\n")
    assert [item for item in items if item] == ["<li>road taken for car: 50.0 % of 2 points</li>"]


def test_rejected_points_are_wrong_but_for_the_official_accuracy(world):
    evaluation = evaluate_scans(find_scans(world.dataset), world.out, SPACE)
    scores = evaluation.scores
    rejection = evaluation.to_dict()["rejection"]
    assert scores.accuracy == 3 / 16, "rejected points are wrong"
    assert scores.accuracy_official == pytest.approx(3 / 4), "rejected points do not count"
    assert (rejection["points"], rejection["accepted"], rejection["wrong"]) == (16, ACCEPTED, 1)


def test_no_second_threshold_is_proposed_to_a_run_that_rejected_labels(world, query):
    for stem in ("0", "1"):
        world.put("uncertainty/error", stem, np.linspace(0.1, 0.4, 10))
    assert report(world.out, query=query).compared.uncertainty.accepted is None
    evaluation = evaluate_scans(find_scans(world.dataset), world.out, SPACE)
    assert evaluation.uncertainty.accepted is None
    assert evaluation.to_dict()["accepted"] is None
    assert evaluation.uncertainty.kinds["error"].points == ACCEPTED


def test_the_served_page_does_not_judge_rejected_points(world, query):
    with view(world.out, query=query) as server:
        assert b"<b>25.0 %</b>risk" in server.page
        shown = server.served.results.read(server.served.results.rows[0])
    wrong = shown.results.wrong(SPACE)
    assert np.isnan(wrong).sum() == 7
    assert wrong[[0, 2, 3]].tolist() == [0, 0, 1]


def test_pictures_and_clouds_state_coverage_and_risk(world, query):
    with calls_of(scan_picture) as pictures:
        picture(world.out, colours=["wrong"], query=query)
    titles = list(pictures[0]["views"])
    assert titles[0] == "errors of the accepted labels: coverage 37.5 %, risk 33.3 %"
    export_ply(world.out, colour="wrong", query=query)
    cloud = plyfile.PlyData.read(world.out / "sequences/08/ply/0.ply")
    assert "coverage 37.5 %, risk 33.3 %" in cloud.comments
    assert np.isnan(cloud["vertex"]["scalar_wrong"]).sum() == 7
