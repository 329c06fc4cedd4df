# SPDX-License-Identifier: MIT
"""The page of a run in headless Chromium: it draws, and its controls work."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
import pytest
from evaluated import CAR, ROAD, SPACE, World
from scans import SMALL, make_scan, write_bin
from served import served

from salsanext_cli import write_labels
from salsanext_cli.geometry.objects import BOX
from salsanext_cli.results.manifest import Manifest, StageRecord
from salsanext_cli.results.paths import output_path
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.stages.report import report, view

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium: make test installs it")
COUNT = 1500
STEMS = ("000000", "000001")
RESULT = re.compile(r"RESULT (\{.*\})\"")
PROBE = """<script>
{
const shown = () => +document.documentElement.dataset.shown;
const result = { shown: shown(), summary: byId("summary").textContent };
const picture = () => {
  view.draw();
  const { gl } = view, { width, height } = gl.canvas;
  const pixels = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  return new Set(new Uint32Array(pixels.buffer));
};
const change = (id, value, name) => {
  byId(id).value = value;
  byId(id).dispatchEvent(new Event(name));
};
const legend = () => [...byId("legend").children];
const at = (target, name, x, y) => target.dispatchEvent(
  new PointerEvent(name, { clientX: x, clientY: y, bubbles: true, pointerId: 1 }));
(async () => {
  result.state = [byId("scan").value, byId("colour").value, byId("by").value, byId("size").value];
  result.colours = Object.fromEntries([...byId("colour").options].map(({ value }) => {
    change("colour", value, "change");
    return [value, picture().size];
  }));
  change("colour", "label", "change");
  byId("all").click();
  result.boxed = ["wrong", "label"].map(colour => {
    change("colour", colour, "change");
    const boxed = picture().size;
    byId("boxes").click();
    const without = picture().size;
    byId("boxes").click();
    return boxed - without;
  });
  result.all = shown();
  result.legend = legend().map(button => button.textContent);
  legend()[0].click();
  result.pressed = legend()[0].getAttribute("aria-pressed");
  await new Promise(done => setTimeout(done, 300));
  result.without = [shown(), picture().size, location.hash];
  legend()[1].dispatchEvent(new MouseEvent("dblclick"));
  result.alone = shown();
  byId("all").click();
  change("by", "entropy", "change");
  change("above", 64, "input");
  result.below = [shown(), byId("above-value").textContent];
  data.scales.error = { marks: [0, 0.1, 1], unit: "" };
  result.marks = [0, 127, 254].map(byte => valueOf("error", byte));
  byId("all").click();
  view.azimuth = 0; view.elevation = 89; view.draw();
  const m = view.matrix(), [x, y, z] = view.place(700);
  const canvas = byId("cloud"), box = canvas.getBoundingClientRect();
  const row = i => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i];
  const px = (row(0) / row(3) + 1) / 2 * box.width;
  const py = (1 - row(1) / row(3)) / 2 * box.height;
  result.picked = view.pick(px, py);
  at(canvas, "pointermove", box.left + px, box.top + py);
  await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
  const point = byId("point");
  result.hover = [point.hidden, point.textContent, +document.documentElement.dataset.point];
  const before_hiding = point.hidden, label = cloud.values.label[result.picked];
  const button = legend().find(entry => entry.textContent.startsWith(data.classes[label].name));
  button.click();
  result.hidden = [before_hiding, point.hidden, view.marked];
  button.click();
  const stage = byId("full").closest("#stage");
  const controls = ["cloud", "play", "colour", "above", "legend"];
  stage.requestFullscreen = () => { result.full = controls.every(id => stage.contains(byId(id))); };
  byId("full").click();
  const before = view.azimuth;
  canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft" }));
  result.turned = view.azimuth - before;
  result.pixels = Array.from({ length: cloud.shown }, (_, i) => pixelOf(i))
    .every((pixel, i) => pixel < 0 || (cloud.first[pixel] <= i && i < cloud.first[pixel + 1]));
  const strip = byId("strip"), area = strip.getBoundingClientRect(), pixel = pixelOf(700);
  at(strip, "pointermove", area.left + (pixel % cloud.width + 0.5) * area.width / cloud.width,
    area.top + (Math.floor(pixel / cloud.width) + 0.5) * area.height / cloud.height);
  result.strip = [cloud.first[pixel], +document.documentElement.dataset.point];
  byId("columns").dispatchEvent(new KeyboardEvent("keydown", { key: "End" }));
  byId("columns").dispatchEvent(new KeyboardEvent("keydown", { key: "Enter" }));
  result.opened = [cloud.name, byId("column").textContent];
  result.fetched = performance.getEntriesByType("resource").length;
  console.log("RESULT " + JSON.stringify(result));
})();
}
</script>"""


@pytest.fixture
def world(tmp_path):
    world = World(tmp_path)
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
    Manifest(world.out).write(StageRecord("predict", settings, ("predictions",)))
    return world


LIVE_PROBE = """<script>
(async () => {
  const soon = () => new Promise(done => setTimeout(done, 20));
  const until = async there => { while (!there()) await soon(); };
  const change = (id, value, name) => {
    byId(id).value = value;
    byId(id).dispatchEvent(new Event(name));
  };
  const played = async () => {
    result.from = [];
    byId("play").click();
    result.playing = byId("play").textContent;
    await until(() => byId("play").textContent === "play");
  };
  const result = { early: view.pick(100, 100), from: [] };
  byId("strip").dispatchEvent(new PointerEvent("pointermove", { clientX: 1, clientY: 1 }));
  await until(() => cloud);
  Object.assign(result, { first: cloud.name, left: document.documentElement.dataset.shown });
  view.show = (old => cloud => { result.from.push(cloud.name); old.call(view, cloud); })(view.show);
  await played();
  result.unread = byId("unread").textContent;
  result.played = [[...result.from], cloud.name, byId("place").value];
  result.column = byId("column").textContent;
  for (const place of [0, 1, 3, 0]) change("place", place, "input");
  await until(() => cloud.name === "08/000000");
  result.summary = byId("summary").textContent;
  result.legend = byId("legend").children[0];
  change("scan", 1, "change");
  await until(() => cloud.name === "08/000001");
  result.legend = result.legend === byId("legend").children[0];
  byId("play").click();
  change("scan", 0, "change");
  await until(() => cloud.name === "08/000000");
  await new Promise(done => setTimeout(done, 500));
  result.chosen = [cloud.name, byId("play").textContent];
  byId("columns").dispatchEvent(new KeyboardEvent("keydown", { key: "End" }));
  byId("columns").dispatchEvent(new KeyboardEvent("keydown", { key: "Enter" }));
  await until(() => cloud.name === "08/000003");
  result.colours = [...byId("colour").options].map(option => option.value);
  change("scan", 2, "change");
  await until(() => byId("scan").value === "3");
  result.failed = [byId("summary").textContent, cloud.name];
  const paths = performance.getEntriesByType("resource").map(entry => new URL(entry.name).pathname);
  result.fetched = paths.map(path => path.split("/").pop());
  console.log("RESULT " + JSON.stringify(result));
})();
</script>"""


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


def result_in(console: str) -> dict[str, Any]:
    """Return what a probe wrote to the console."""
    written = RESULT.search(console)
    assert written, console
    result: dict[str, Any] = json.loads(written[1].replace('\\"', '"').replace("\\\\", "\\"))
    return result


def test_the_page_draws_and_its_controls_work(world, tmp_path):
    made = report(world.out, query=ResultQuery(world.dataset), scans=["000001", "000000"])
    page = tmp_path / "with a probe.html"
    page.write_text(made.page.read_text("utf-8").replace("</body>", f"{PROBE}</body>"), "utf-8")
    wanted = {"scan": "08/000000", "colour": "wrong", "by": "entropy", "above": "0.5", "size": "4"}
    console = console_of(f"{page.as_uri()}#{urlencode(wanted)}", tmp_path)
    result = result_in(console)
    lines = [line for line in console.splitlines() if "CONSOLE" in line]
    assert sum("GL Driver Message" not in line for line in lines) == 1, console
    # The address hides entropies above 0.5; they go from 0 to 2.
    assert result["state"] == ["1", "wrong", "entropy", "4"]
    assert abs(result["shown"] - COUNT / 4) < 0.02 * COUNT
    assert re.search(r"1,500 points, 2\d\.\d % visible: \d+\.\d % wrong", result["summary"])
    assert [*result["colours"]] == ["label", "truth", "wrong", "entropy", "range", "intensity"]
    # The background and at least two colours, many for values.
    assert all(count >= 3 for count in result["colours"].values())
    assert min(result["colours"][name] for name in ("entropy", "range", "intensity")) > 20
    # Boxes keep the colour of their class.
    assert result["boxed"] == [1, 0]
    assert result["all"] == COUNT
    cars, roads = (float(text.split()[1]) / 100 for text in result["legend"])
    shown, colours, address = result["without"]
    assert result["pressed"] == "false"
    assert shown == pytest.approx(COUNT * roads, abs=COUNT / 2000)
    assert colours == result["colours"]["label"] - 1
    assert "hide=car" in address
    assert result["alone"] == shown
    assert cars + roads == pytest.approx(1)
    assert abs(result["below"][0] - COUNT / 4) < 0.02 * COUNT
    assert result["marks"] == [0, 0.1, 1]
    hidden, words, point = result["hover"]
    assert result["picked"] == point >= 0
    assert not hidden
    assert re.search(r"label +(car|road)\ntruth +(car|road)\n", words)
    assert re.search(r"entropy +(0|[\d.]+) nats\n", words)
    # The description of a point disappears with its class.
    assert result["hidden"] == [False, True, -1]
    assert result["full"]
    assert result["turned"] == 5
    assert result["pixels"]
    assert result["strip"][0] == result["strip"][1]
    assert result["opened"][0] == "08/000001"
    assert result["opened"][1].startswith("08/000001 · mean entropy 0.5")
    assert result["fetched"] == 0


@pytest.mark.slow
def test_the_live_page_plays_the_drive_and_names_failures(world, tmp_path, monkeypatch):
    for stem in ("000002", "000003"):
        world.add(stem, [CAR, ROAD], [CAR, CAR])
    with view(world.out, query=ResultQuery(world.dataset)) as server, served(server):
        (world.dataset / "sequences/08/velodyne/000002.bin").write_bytes(b"damaged")
        page = server.page.replace(b"</body>", f"{LIVE_PROBE}</body>".encode())
        monkeypatch.setattr(server, "page", page)
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
