# SPDX-License-Identifier: MIT
import json
import re
import shutil
from datetime import datetime
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from evaluation_runs import CAR, MOVING_CAR, ROAD, SPACE, UNKNOWN, World
from other_program import require_kept
from scans import SMALL, refused, write_array

from salsanext_cli import label_space
from salsanext_cli.commands.stages import report as stage
from salsanext_cli.commands.stages.report import read_run, report
from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.errors import NoInputError, OutputError
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.results.manifest import Manifest, StageRecord
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.query import ResultQuery

PERSON = 30
DAYS = {
    "sequences/08/predictions/000000.label": (2020, 1, 2),
    "sequences/08/uncertainty/error/000000.npy": (2021, 3, 4),
    "sequences/08/pictures/000000.png": (2022, 5, 6),
    "report.html": (2022, 5, 7),
}
"""Files that a list of written files names, and the days of their writing."""
TRUTH, PREDICTED = [CAR, ROAD, ROAD, MOVING_CAR], [CAR, CAR, ROAD, CAR]


class Page(HTMLParser):
    """Elements and texts of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, str] = {}
        self.text = ""
        self._open = ""
        self.source = path.read_text("utf-8")
        self.feed(self.source)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self._open = dict(attrs).get("id") or "" if tag == "script" else ""

    def handle_endtag(self, tag):
        self._open = ""

    def handle_data(self, data):
        if self._open:
            self.texts[self._open] = data
        else:
            self.text += data

    @property
    def data(self):
        return json.loads(self.texts["data"])


@pytest.fixture
def world(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    world = World(tmp_path)
    world.add("000000", TRUTH, PREDICTED)
    world.add("000001", TRUTH, TRUTH)
    return world


def made(world, space=None, **options):
    query = ResultQuery(world.dataset, label_space=space)
    result = report(world.out, query=query, **options)
    assert result.page == world.out / "report.html"
    assert result.to_dict()["bytes"] == result.page.stat().st_size
    return result, Page(result.page)


def test_a_page_that_was_written_meanwhile_is_kept(world, tmp_path):
    page = tmp_path / "page.html"

    def write_page(overwrite):
        query = ResultQuery(world.dataset)
        report(world.out, page, query=query, options=RunOptions(overwrite=overwrite))

    require_kept(stage, page, write_page)


def test_the_date_is_that_at_which_results_were_written(world):
    """Copies have other times; results of another program have no known date."""
    _, page = made(world)
    assert "results of" not in page.text
    (listing,) = (world.out / ".salsanext.files").iterdir()
    noon_ns = {name: int(datetime(*day, 12).timestamp() * 1e9) for name, day in DAYS.items()}
    lines = [f"{name}\t28\t{time_ns}\n" for name, time_ns in noon_ns.items()]
    lines.append(listing.read_text())
    listing.write_text("".join(lines))
    _, page = made(world)
    assert page.text.count("results of 2021-03-04") == 1


def test_scores_are_the_same_as_in_eval(world):
    world.put("uncertainty/entropy", "000000", [0.1, 2, 0.1, 0.1])
    world.put("uncertainty/entropy", "000001", [0.1] * 4)
    result, page = made(world)
    evaluated = world.evaluate()
    numbers, sentence = result.to_dict(), evaluated.uncertainty.accepted.sentence
    assert numbers["accuracy"] == evaluated.scores.accuracy == 7 / 8
    assert numbers["iou_mean_present"] == evaluated.scores.iou_mean_present
    assert numbers["sentence"] == sentence
    for text in ("87.5 %", sentence[1:], "not recorded", "8 labelled points, 2 scans with labels"):
        assert text in page.text
    # Plots of the IoU and of the uncertainty, and a thumbnail of each scan.
    assert page.source.count("data:image/png;base64,") == 4
    assert [*result.shown] == ["08/000000", "08/000001"]
    assert page.data["drive"]["kind"] == "entropy"


def test_the_tiles_and_the_decision_have_the_numbers_of_the_run(world):
    line = {"slope": 1.0, "offset": 0.0, "deviation": 0.02}
    settings = {"label_space": SPACE.to_dict(), "sensor": SMALL.to_dict(), "accuracy": line}
    shutil.rmtree(world.dataset / "sequences/08/labels")
    Manifest(world.out).write(
        StageRecord(stage="predict", settings=settings, writes=("predictions",))
    )
    for stem in ("000000", "000001"):
        world.put("uncertainty/least_confidence", stem, [0.2] * 4)
        world.put("uncertainty/error", stem, [0.05, 0.05, 0.05, 0.45])
    result, page = made(world)
    tiles = dict(re.findall("<div><b>([^<]*)</b>([^<]*)</div>", page.source))
    assert tiles["2"] == "scans, 8 points"
    # A slope of 1 leaves the confidence of 80 %; 3.5 deviations are 7 points.
    assert tiles["73 to 87 %"] == "estimated accuracy, from confidence"
    assert (
        tiles["15.0 %"]
        == "mean probability of error of 8 points with a label, 25.0 % of them above 10 %"
    )
    assert tiles["0"] == "scans with warnings"
    assert result.to_dict()["decision"]["decision"] == "coarse"
    assert "<b>Use coarse classes</b>: the estimated accuracy is 73 to 87 %" in page.source
    sparse = {"08/000000": [Finding("sparse", "few rows", "look")]}
    sparse["08/000001"] = sparse["08/000000"]
    OwnedFolder(world.out, "predict").record_findings(sparse, set(sparse))
    result, page = made(world)
    tiles = dict(re.findall("<div><b>([^<]*)</b>([^<]*)</div>", page.source))
    assert tiles["withheld"] == "estimated accuracy: sparse in 2 scans"
    assert tiles["2"] == "scans with warnings: sparse 2"
    assert page.data["drive"]["codes"] == [["sparse"], ["sparse"]]
    assert result.to_dict()["decision"]["decision"] == "label-10"


def test_rejected_points_have_a_tile_and_withhold_the_estimate(world):
    settings = {"label_space": SPACE.to_dict(), "sensor": SMALL.to_dict(), "reject": 0.3}
    Manifest(world.out).write(
        StageRecord(stage="predict", settings=settings, writes=("predictions",))
    )
    world.put("uncertainty/error", "000000", [0.3, 0.31, 0.9, np.nan])
    world.put("uncertainty/error", "000001", [0.0] * 4)
    result, page = made(world)
    tiles = dict(re.findall("<div><b>([^<]*)</b>([^<]*)</div>", page.source))
    # Two of the seven points with a label.
    assert tiles["28.6 %"] == "of the points with a label rejected: error above 0.3"
    words = "of 7 points with a label (rejected ones included), 42.9 % of them above 10 %"
    assert any(tile.endswith(words) for tile in tiles.values())
    assert "withheld" in tiles
    # The errors of all labels do not describe the accepted ones.
    assert result.to_dict()["decision"] is None
    assert 'class="decision"' not in page.source
    assert "No decision" in page.text
    tilted = {
        f"08/{stem}": [Finding("tilted", "leans", "level it")] for stem in ("000000", "000001")
    }
    OwnedFolder(world.out, "predict").record_findings(tilted, set(tilted))
    result, _ = made(world)
    assert result.to_dict()["decision"]["decision"] == "correct"


def test_a_page_has_a_bounded_number_of_thumbnails(world, monkeypatch):
    world.put("uncertainty/entropy", "000000", [0.1] * 4)
    world.put("uncertainty/entropy", "000001", [0.9] * 4)
    monkeypatch.setattr("salsanext_cli.report.page.thumbnails.MAX_THUMBNAILS", 1)
    _, page = made(world, scans=["000000"])
    first, second = page.data["drive"]["thumbnails"]
    assert first.startswith("data:image/png;base64,")
    assert second == ""
    _, page = made(world, scans=["000001"])
    assert page.data["drive"]["thumbnails"][0] == ""


def test_cells_of_the_confusion_matrix_name_the_scan_with_most_of_their_points(world):
    world.add("000002", [ROAD] * 5, [CAR] * 5)
    _, page = made(world, scans=["000000"])
    car, road = 1, 9
    cells = page.data["cells"]
    # Only the first scan is in the page; the last one has most of the points.
    assert cells[f"{road},{car}"] == [0, "08/000002"]
    assert cells.keys() == {f"{car},{car}", f"{road},{car}", f"{road},{road}"}
    assert f'data-cell="{road},{car}"' in page.source
    _, page = made(world, scans=["000002"])
    assert page.data["cells"][f"{car},{car}"][0] == -1


def test_confusions_are_in_words_and_absent_classes_have_no_iou(world):
    world.add("000002", [ROAD] * 5, [PERSON] * 5)
    _, page = made(world)
    lines = page.source.partition("Largest confusions")[2].partition("</ol>")[0]
    # Five of nine points of road are labelled person, one is labelled car.
    assert re.findall("<li>(.*?)</li>", lines) == [
        "road taken for person: 55.6 % of 9 points",
        "road taken for car: 11.1 % of 9 points",
    ]
    row = r"<tr><td>([\w-]+)</td>.*?<td>(?:<i [^>]*></i> )?([^<]*)</td></tr>"
    rows = dict(re.findall(row, page.source))
    assert rows == {"car": "80.0 %", "road": "33.3 %", "person": "–"}
    assert page.data["occurring"]["truth"] == [1, 9]
    assert page.data["occurring"]["label"] == [1, 6, 9]


def test_without_labels_there_are_no_scores(world):
    shutil.rmtree(world.dataset / "sequences/08/labels")
    result, page = made(world)
    numbers = result.to_dict()
    assert [numbers[key] for key in ("accuracy", "iou_mean_present", "sentence")] == [None] * 3
    assert "accuracy" not in page.text
    assert "<img" not in page.source.partition("<script")[0]
    assert [*result.shown.values()] == ["at random"]
    assert "label" in json.loads(page.texts["cloud-0"])["values"]


def test_uncertainty_alone_is_shown(world):
    shutil.rmtree(world.out)
    write_array(output_path(world.out, "08", "uncertainty/error", "000001"), np.full(4, 0.5, "f4"))
    result, page = made(world)
    assert len(result.run.rows) == 1
    assert "No stage has predicted labels" in page.text
    assert result.shown == {"08/000001": "most uncertain (mean probability of error 50.0 %)"}


def test_a_page_fetches_nothing(world):
    _, page = made(world)
    assert "://" not in page.source
    assert "default-src 'none'" in page.source
    for tag, attributes in page.tags:
        assert tag not in ("link", "iframe", "object", "base", "form")
        links = [attributes[key] or "" for key in ("src", "href") if key in attributes]
        assert all(link.startswith(("data:image/png;base64,", "#")) for link in links), tag


def test_names_are_no_markup(tmp_path):
    evil = "a\"'&<script>alert(1)<∕script><!--"
    world = World(tmp_path)
    world.out = tmp_path / "<b>öut"
    world.add("000000", TRUTH, PREDICTED, sequence=evil)
    world.add("<∕scr\nipt>", [ROAD] * 10, [UNKNOWN] + [ROAD] * 9, sequence="08")
    world.add("x\udcff", TRUTH, TRUTH, sequence="08")
    result, page = made(world, scans=[f"{evil}/000000", "x\udcff"])
    scripts = [attributes for tag, attributes in page.tags if tag == "script"]
    identifiers = [attributes.get("id") for attributes in scripts]
    # An import map and the start of the page follow the data.
    assert identifiers == ["data", "cloud-0", "cloud-1", None, None]
    assert [attributes["type"] for attributes in scripts[3:]] == ["importmap", "module"]
    assert f"{evil}/000000" in page.data["drive"]["names"]
    assert "<b>öut" not in page.source
    assert [scan["name"] for scan in page.data["shown"]] == [f"{evil}/000000", "08/x\\xff"]
    assert [*result.shown] == [f"{evil}/000000", "08/x\udcff"]
    assert "unknown ids 77 (1×)" in page.text


def test_names_of_classes_are_no_markup(world):
    evil = "</script><img src=x onerror=alert(1)>"
    space = SPACE.to_dict()
    space["labels"] = {**space["labels"], ROAD: evil}
    result, page = made(world, space=type(SPACE).from_dict(space))
    assert evil not in page.source
    assert page.data["classes"][9]["name"] == evil
    assert any(evil in reason for reason in result.shown.values())


@pytest.mark.usefixtures("workers_in_process")
def test_a_page_is_the_same_whatever_the_order_of_the_scans(world):
    for number in range(2, 30):
        world.add(f"{number:06}", TRUTH, PREDICTED if number % 3 else TRUTH)
        world.put("uncertainty/entropy", f"{number:06}", [0.1 * number, 0, np.nan, 1])
    one, _ = made(world)
    first = one.page.read_bytes()
    made(world, options=RunOptions(jobs=2))
    assert one.page.read_bytes() == first


def test_a_scan_that_cannot_be_read_is_named(world):
    world.add("000002", TRUTH, PREDICTED)
    output_path(world.out, "08", "predictions", "000002").write_bytes(b"123")
    result, page = made(world)
    assert [failure.scan.stem for failure in result.failures] == ["000002"]
    assert "000002.label" in page.text
    assert len(result.run.rows) == 2
    for stem in ("000000", "000001"):
        (world.dataset / f"sequences/08/velodyne/{stem}.bin").write_bytes(b"123")
    with pytest.raises(NoInputError):
        made(world)


def test_missing_results_missing_scans_and_foreign_pages_are_refused(world):
    refused(NoInputError, world.out / "none", report, world.out / "none")
    page = made(world)[0].page
    made(world)
    page.write_text("mine")
    with pytest.raises(OutputError) as caught:
        made(world)
    assert (caught.value.subject, page.read_text()) == (str(page), "mine")
    page.unlink()
    world.dataset.rename(world.dataset.with_name("moved"))
    refused(NoInputError, world.out / "sequences/08", report, world.out)


def test_probabilities_of_merged_classes_are_added(world):
    settings = {"label_space": SPACE.to_dict(), "sensor": SMALL.to_dict()}
    Manifest(world.out).write(
        StageRecord(stage="predict", settings=settings, writes=("predictions", "probabilities"))
    )
    rows = np.zeros((4, SPACE.class_count))
    rows[:, SPACE.names.index("road")] = 0.5
    rows[:, SPACE.names.index("sidewalk")] = 0.3
    rows[:, SPACE.names.index("building")] = 0.2
    world.put("probabilities", "000000", rows)
    for classes, doubt in ((None, 0.5), (label_space("coarse"), 0.2)):
        run, _ = read_run(world.out, query=ResultQuery(world.dataset, classes=classes))
        kinds = [run.read(row).results.uncertainty for row in run.rows]
        (one,) = (known["least_confidence"] for known in kinds if "least_confidence" in known)
        np.testing.assert_allclose(one, doubt, atol=1e-3)


def test_a_page_is_written_to_a_file_and_replaced_only_if_asked(world, tmp_path):
    query = ResultQuery(world.dataset)
    target = tmp_path / "page.html"
    assert report(world.out, target, query=query).page == target
    assert Page(target).data == made(world)[1].data
    target.write_text("mine")
    with refused(OutputError, target):
        report(world.out, target, query=query)
    assert target.read_text() == "mine"
    report(world.out, target, query=query, options=RunOptions(overwrite=True))
    assert target.read_text() != "mine"
    with refused(OutputError, "page.txt"):
        report(world.out, Path("page.txt"), query=query)


def test_a_data_set_is_named_as_such_instead_of_results(world):
    with refused(NoInputError, world.dataset) as caught:
        report(world.dataset)
    assert f"salsanext predict '{world.dataset}' '{world.dataset}-out'" in caught.value.hint
