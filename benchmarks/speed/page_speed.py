# SPDX-License-Identifier: MIT
"""Time of a picture, a switch and a search in the page of `salsanext report`, in headless Chromium.

It renders in software, draws 1198 × 467 pixels of the first scan, and waits for each picture to be
complete. All times are in milliseconds.

Run: python -m benchmarks.speed.page_speed out/report.html
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from urllib.request import urlopen

PORT, WAIT_S = 19333, 120
PROBE = """<script type="module">
import { byId } from "page/data.js";
import { page } from "page/state.js";
setTimeout(() => {
  const { view } = page;
  const { gl } = view;
  const pixel = new Uint8Array(4);
  const change = (id, value, name) => {
    byId(id).value = value;
    byId(id).dispatchEvent(new Event(name));
  };
  const each = (count, act) => {
    const start = performance.now();
    for (let i = 0; i < count; i++) {
      act(i);
      view.draw();
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    }
    return +((performance.now() - start) / count).toFixed(1);
  };
  const names = [...byId("colour").options].map(option => option.value);
  document.title = JSON.stringify({
    points: view.count,
    pixels: [view.canvas.width, view.canvas.height],
    picture: each(60, () => view.turn(3, 0)),
    switch: each(2 * names.length, i => change("colour", names[i % names.length], "change")),
    slider: each(20, i => change("above", 100 + 5 * i, "input")),
    search: each(20, i => view.pick(100 + 40 * i, 250)),
  });
}, 1000)</script>"""


def main(page: Path) -> None:
    """Open a copy of a page that measures itself and puts what it finds into its title."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "page.html"
        copy.write_text(page.read_text("utf-8").replace("</body>", f"{PROBE}</body>"), "utf-8")
        options = (
            "--headless",
            "--no-sandbox",
            "--use-angle=swiftshader",
            "--window-size=1280,900",
        )
        remote = f"--remote-debugging-port={PORT}"
        chromium = subprocess.Popen(
            [
                *("chromium", *options, "--enable-unsafe-swiftshader", remote),
                *(f"--user-data-dir={folder}/profile", copy.as_uri()),
            ],
            stderr=subprocess.DEVNULL,
        )
        try:
            print(title_of_page())
        finally:
            chromium.terminate()
            chromium.wait()


def title_of_page() -> str:
    """Wait for the title that holds the result."""
    for _ in range(WAIT_S):
        time.sleep(1)
        try:
            with urlopen(f"http://127.0.0.1:{PORT}/json") as answer:
                pages = [each for each in json.load(answer) if each["type"] == "page"]
        except OSError:
            continue  # It is starting.
        if pages and "picture" in pages[0]["title"]:
            return str(pages[0]["title"]).replace("&quot;", '"')
    raise SystemExit("no result")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
