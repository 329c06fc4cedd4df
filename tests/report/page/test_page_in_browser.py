# SPDX-License-Identifier: MIT
"""The page of a run in headless Chromium: it draws, and its controls work."""

import json
import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
import pytest
from background_server import served
from evaluation_runs import CAR, ROAD, SPACE, World
from scans import SMALL, make_scan, write_bin

from salsanext_cli import read_labels, write_labels
from salsanext_cli.commands.stages.report import report, view
from salsanext_cli.core.geometry.objects import BOX
from salsanext_cli.runs.results.manifest import Manifest, StageRecord
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.query import ResultQuery

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium: make test installs it")
COUNT = 1500
STEMS = ("000000", "000001")
RESULT = re.compile(r"RESULT (\{.*\})\"")


def script(name: str) -> str:
    """Return the element of a script that a test adds to a page."""
    return f'<script type="module">{Path(__file__).with_name(name).read_text("utf-8")}</script>'


PROBE, LIVE_PROBE = script("page_probe.js"), script("live_page_probe.js")


def world_in(folder: Path) -> World:
    """Return two scans whose labels, uncertainties and boxes are known."""
    world = World(folder)
    random = np.random.default_rng(0)
    for number, stem in enumerate(STEMS):
        truth = np.where(random.random(COUNT) < 0.5, CAR, ROAD)
        world.add(stem, truth, truth)
        scans = world.dataset / "sequences/08/velodyne"
        write_bin(scans / f"{stem}.bin", make_scan(COUNT, number))
        predicted = np.where(random.random(COUNT) < 0.2, CAR, truth).astype(np.uint32)
        write_labels(output_path(world.out, "08", "predictions", stem), predicted)
        world.put("uncertainty/entropy", stem, np.linspace(0, 1, COUNT) * (len(STEMS) - number))
        boxes = output_path(world.out, "08", "objects", stem)
        boxes.parent.mkdir(parents=True, exist_ok=True)
        boxes.write_text(f"object,class,points,{','.join(BOX)}\n1,car,9,0,0,0,20,9,4,0.3\n")
    settings = {"label_space": SPACE.to_dict(), "sensor": SMALL.to_dict()}
    Manifest(world.out).write(
        StageRecord(stage="predict", settings=settings, writes=("predictions",))
    )
    return world


@pytest.fixture
def world(tmp_path):
    return world_in(tmp_path)


def console_of(page: str, tmp_path: Path) -> str:
    """Open a page; return what it writes to the console."""
    command = [
        *(CHROMIUM or "", "--headless", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
        *(["--no-sandbox"] if os.geteuid() == 0 else []),
        *("--disable-dev-shm-usage", "--disable-background-networking", "--window-size=1280,900"),
        *(f"--user-data-dir={tmp_path / 'profile'}", "--enable-logging=stderr"),
        "--run-all-compositor-stages-before-draw",
        *("--virtual-time-budget=200000", "--dump-dom", page),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert 'data-ready="yes"' in done.stdout, done.stderr
    return "\n".join(line for line in done.stderr.splitlines() if ":CONSOLE" in line)


def most_confused(world: World, truth: int, label: int) -> tuple[str, int]:
    """Return the scan with most points of a class that have another label, and their number."""
    counts = {}
    for stem in STEMS:
        labels = read_labels(world.dataset / f"sequences/08/labels/{stem}.label")
        predicted = read_labels(output_path(world.out, "08", "predictions", stem))
        counts[f"08/{stem}"] = int(((labels == truth) & (predicted == label)).sum())
    name = max(counts, key=lambda scan: counts[scan])
    return name, counts[name]


def result_in(console: str) -> dict[str, Any]:
    """Return what a probe wrote to the console."""
    written = RESULT.search(console)
    assert written, console
    result: dict[str, Any] = json.loads(written[1].replace('\\"', '"').replace("\\\\", "\\"))
    return result


@dataclass(frozen=True, kw_only=True)
class ProbedPage:
    """A page, what a probe found in it, and the console of the browser."""

    world: World
    result: dict[str, Any]
    console: str


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> ProbedPage:
    """Return the page of an address that hides entropies above 0.5; they go from 0 to 2."""
    folder = tmp_path_factory.mktemp("page")
    world = world_in(folder)
    made = report(world.out, query=ResultQuery(world.dataset), scans=["000001", "000000"])
    path = folder / "with a probe.html"
    path.write_text(made.page.read_text("utf-8").replace("</body>", f"{PROBE}</body>"), "utf-8")
    state = {"scan": "08/000000", "colour": "wrong", "by": "entropy", "above": "0.5", "size": "4"}
    console = console_of(f"{path.as_uri()}#{urlencode(state)}", folder)
    return ProbedPage(world=world, result=result_in(console), console=console)


@pytest.fixture
def result(page: ProbedPage) -> dict[str, Any]:
    return page.result


def test_nothing_but_the_probe_writes_to_the_console(page):
    lines = [line for line in page.console.splitlines() if "CONSOLE" in line]
    assert sum("GL Driver Message" not in line for line in lines) == 1, page.console


def test_the_address_sets_the_view(result):
    assert result["state"] == ["1", "wrong", "entropy", "4"]
    assert abs(result["shown"] - COUNT / 4) < 0.02 * COUNT
    visible = (
        r"1,500 points, 2\d\.\d % visible: \d+\.\d % of the 3\d\d visible labelled points wrong"
    )
    assert re.search(visible, result["summary"])
    # Truth beside the colour of the address, "wrong".
    assert result["panes"] == [2, "truth", False]


def test_each_colour_draws_the_points(result):
    assert [*result["colours"]] == ["label", "truth", "wrong", "entropy", "range", "intensity"]
    # The background and at least two colours, many for values.
    assert all(count >= 3 for count in result["colours"].values())
    assert min(result["colours"][name] for name in ("entropy", "range", "intensity")) > 20
    # Boxes keep the colour of their class.
    assert result["boxed"] == [1, 0]
    assert result["pixels"]


def test_the_legend_hides_and_shows_classes(result):
    assert result["all"] == COUNT
    cars, roads = (float(text.split()[1]) / 100 for text in result["legend"])
    shown, colours, address = result["without"]
    assert result["pressed"] == "false"
    assert shown == pytest.approx(COUNT * roads, abs=COUNT / 2000)
    assert colours == result["colours"]["label"] - 1
    assert "hide=car" in address
    assert result["alone"] == shown
    assert cars + roads == pytest.approx(1)


def test_sliders_have_marks_and_hide_points(result):
    assert abs(result["below"][0] - COUNT / 4) < 0.02 * COUNT
    assert result["marks"] == [0, 0.1, 1]
    assert result["ticks"] == ["0", "0.5", "1", "1.5"]
    assert result["scales"] == [False, True]


def test_a_point_is_described_as_long_as_its_class_is_shown(result):
    hidden, words, point = result["hover"]
    assert result["picked"] == point >= 0
    assert not hidden
    assert re.search(r"label +(car|road)\ntruth +(car|road)\n", words)
    assert re.search(r"entropy +(≥ )?[\d.]+ nats\n", words)
    assert result["hidden"] == [False, True, -1]


def test_the_camera_turns_and_looks_where_the_points_are(result):
    assert result["full"]
    assert result["turned"] == 5
    assert result["strip"][0] == result["strip"][1]
    # It shows nine points of ten, and looks where the points are: here to the left.
    assert min(result["inside"]) >= 0.9
    assert result["azimuths"] == [180, 270, 180]


def test_each_half_of_the_picture_has_its_own_colours_and_finds_points(result):
    assert result["halves"] == [[False, True], [True, False]]
    assert result["both"][0] == result["both"][1] >= 0
    assert not result["strips"]


def test_a_cell_of_the_confusion_matrix_shows_its_points(page):
    result = page.result
    most, points = most_confused(page.world, ROAD, CAR)
    name, shown, summary, address = result["cell"]
    assert (name, shown) == (most, points)
    assert f"{points} of them points of road taken for car" in summary
    assert "truth=road&taken=car" in address
    assert result["faint"]
    assert result["cleared"] == [COUNT, None]


def test_the_table_of_scans_is_sorted_and_has_pictures(result):
    # The most uncertain scan is first; names rise, then fall.
    rising = ["08/000000", "08/000001"]
    assert result["rows"] == [rising, rising[::-1], rising, rising[::-1]]
    assert result["sorted"] == "scan"
    assert result["pictures"] == [96, 96]
    assert result["columns"][:3] == ["tag", "from above, by class", "scan"]
    assert result["opened"][0] == "08/000001"
    assert result["opened"][1].startswith("08/000001 · mean entropy 0.5")


def test_plots_are_as_wide_as_their_pixels_allow(result):
    assert len(result["plots"]) == 2
    assert all(500 <= width <= 620 for width in result["plots"])


def test_links_have_the_words_of_their_headings(result):
    links = [link for link, _ in result["links"]]
    assert links == [heading for _, heading in result["links"]]
    assert len(set(links)) == len(links) == 4


def test_tags_are_saved_as_a_list_that_pick_reads(result):
    saved, disabled, tags = result["tags"]
    assert result["nothing"]
    assert not disabled
    assert tags == ["08/000000", "08/000001"]
    assert result["untagged"] == ["08/000001"]
    assert [line for line in saved.splitlines() if not line.startswith("#")] == tags
    # The folder of `pick --count` may exist.
    assert "salsanext pick SCANS tagged/ --from tagged.txt" in saved


def test_the_page_fetches_nothing(result):
    assert result["fetched"] == 0


def test_the_page_fits_a_narrow_screen(world, tmp_path):
    made = report(world.out, query=ResultQuery(world.dataset))
    probe = script("narrow_page_probe.js")
    (tmp_path / "page.html").write_text(
        made.page.read_text("utf-8").replace("</body>", f"{probe}</body>"), "utf-8"
    )
    # Windows of Chromium are wider than telephones, frames are not.
    frame = tmp_path / "frame.html"
    frame.write_text(
        '<html data-ready="yes"><iframe src="page.html" style="width:390px;height:800px">'
    )
    result = result_in(console_of(frame.as_uri(), tmp_path))
    assert result["width"] <= 390
    assert result["beyond"] == []
    assert result["panes"] == [1, 2]


@pytest.mark.slow
def test_the_live_page_plays_the_drive_and_names_failures(world, tmp_path):
    for stem in ("000002", "000003"):
        world.add(stem, [CAR, ROAD], [CAR, CAR])
    with view(world.out, query=ResultQuery(world.dataset)) as server, served(server):
        (world.dataset / "sequences/08/velodyne/000002.bin").write_bytes(b"damaged")
        server.page = server.page.replace(b"</body>", f"{LIVE_PROBE}</body>".encode())
        state = {"scan": "08/000000", "colour": "wrong", "by": "entropy", "above": "0.5"}
        console = console_of(f"{server.url}#{urlencode(state)}", tmp_path)
    result = result_in(console)
    assert result["early"] == -1
    assert result["first"] == "08/000000"
    # The address hides entropies, which go from 0 to 2, above 0.5.
    assert abs(int(result["left"]) - COUNT / 4) < 0.02 * COUNT
    assert result["playing"] == "pause"
    # The animation skips the unreadable scan.
    assert result["played"] == [["08/000001", "08/000003"], "08/000003", "3"]
    assert result["column"].startswith("08/000003 ")
    assert result["unread"].startswith("could not be read: 08/000002: ")
    assert "000002.bin" in result["unread"]
    assert "% visible" in result["summary"]
    assert result["legend"], "the buttons stay"
    assert result["chosen"] == ["08/000000", "play"]
    assert result["colours"] == ["label", "truth", "wrong", "range", "intensity"]
    summary, shown = result["failed"]
    assert summary.startswith("2 points")
    assert shown == "08/000003"
    # Scans in memory are not requested again; unreadable scans are.
    assert sorted(set(result["fetched"])) == ["0", "1", "2", "3"]
    assert [result["fetched"].count(index) for index in "013"] == [1, 1, 1]
