# SPDX-License-Identifier: MIT
"""Regenerate what the guides show, with the default weights: run it again when these change.

    SALSANEXT_REAL_DATA=… python docs/refresh.py              # all of it
    SALSANEXT_REAL_DATA=… python docs/refresh.py figures semantickitti pandaset
    SALSANEXT_REAL_DATA=… python docs/refresh.py outputs tutorials/own-sensor.md
    SALSANEXT_REAL_DATA=… python docs/refresh.py pictures demo.gif

`figures` measures docs/figures.json (docs/measurements.py) and writes the values into the pages.
`outputs` runs the commands of the tutorials and captures their outputs (docs/guide.py).
`pictures` draws docs/images (docs/pictures/).
"""

from __future__ import annotations

import argparse
import ast
import datetime
import hashlib
import json
import os
import tempfile
from pathlib import Path

import guide
from measurements import MEASURES
from pictures import OF_PAGE, PICTURES, example, ranking, sampling
from prepared import prepared_folder

import salsanext_cli.report.page
from salsanext_cli.io.weights.card_file import default_weights

CAPTURED = (
    "start/first-scan.md",
    "tutorials/own-sensor.md",
    "tutorials/few-labels.md",
    "tutorials/semantickitti.md",
    "tutorials/paper.md",
    "tutorials/guarantee.md",
)
"""Pages whose commands are run, each in a folder of its own."""
DRAWN = guide.DOCS / "pictures.json"
"""SHA-256 of the weights that each picture was drawn with, and of the page that it shows."""
PAGE = Path(salsanext_cli.report.page.__file__).parent
"""Files of the page of `report`."""
MEASURED = MEASURES | {
    "pictures": example.measured,
    "ranking": ranking.measured,
    "sampling": sampling.measured,
}


def main() -> None:
    """Regenerate all, a part, or named items of a part."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", nargs="?", choices=[*PARTS])
    parser.add_argument("names", nargs="*")
    given = parser.parse_args()
    data = Path(os.environ["SALSANEXT_REAL_DATA"], "data").resolve()
    for part in [given.part] if given.part else PARTS:
        PARTS[part](data, given.names)


def figures(data: Path, names: list[str]) -> None:
    """Measure groups of figures, and write their values into the pages."""
    stored = guide.stored_figures()
    weights = digest_of_weights()
    home = Path.cwd()
    for name in names or MEASURED:
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            values = MEASURED[name](data)
            os.chdir(home)
        today = datetime.date.today().isoformat()
        stored[name] = {"weights": weights, "date": today} | values
        guide.FIGURES.write_text(json.dumps(stored, indent=1, sort_keys=True) + "\n", "utf-8")
        print(f"{name}: {values}", flush=True)
    for page in guide.PAGES:
        text = page.read_text("utf-8")
        page.write_text(guide.with_figures(text, stored), "utf-8")


def outputs(data: Path, names: list[str]) -> None:
    """Run the commands of pages, and write what they print into the pages."""
    for name in names or CAPTURED:
        page = guide.DOCS / name
        with tempfile.TemporaryDirectory() as folder:
            prepared_folder(Path(folder), data)
            text = guide.outputs(page.read_text("utf-8"), Path(folder))
        page.write_text(text.replace(folder, "/home/you"), "utf-8")
        print(name, flush=True)


def pictures(data: Path, names: list[str]) -> None:
    """Draw pictures, and note the weights that they show."""
    for name in names or PICTURES:
        PICTURES[name](data, guide.DOCS / "images" / name)
        drawn = recorded_pictures() | {name: digests_of_picture(name)}
        DRAWN.write_text(json.dumps(drawn, indent=1, sort_keys=True) + "\n", "utf-8")
        print(name, flush=True)


def recorded_pictures() -> dict[str, dict[str, str]]:
    """Return the digests that each picture was drawn with, as `digests_of_picture`."""
    drawn: dict[str, dict[str, str]] = json.loads(DRAWN.read_text("utf-8"))
    return drawn


def digests_of_picture(name: str) -> dict[str, str]:
    """Return the present SHA-256 of what a picture depends on: the weights, and the page."""
    digests = {"weights": digest_of_weights()}
    return digests | {"page": digest_of_page(PAGE)} if name in OF_PAGE else digests


def digest_of_page(folder: Path) -> str:
    """Return the joined SHA-256 of the source files of the page and its templates, by name.

    Of modules, imports do not count: they change where modules are moved, and the page does not.
    """
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix != ".pyc":
            source = path.read_text("utf-8")
            shown = without_imports(source) if path.suffix == ".py" else source
            digest.update(f"{path.name}\n".encode())
            digest.update(hashlib.sha256(shown.encode()).digest())
    return digest.hexdigest()


class WithoutImports(ast.NodeTransformer):
    """Removal of imports at any place of a module."""

    def visit_Import(self, node: ast.Import) -> None:
        """Remove an import."""

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        """Remove an import."""


def without_imports(source: str) -> str:
    """Return the code of a module without its imports and comments."""
    return ast.unparse(WithoutImports().visit(ast.parse(source)))


def digest_of_weights() -> str:
    """Return the SHA-256 of the default weights."""
    return hashlib.sha256(default_weights().read_bytes()).hexdigest()


PARTS = {"figures": figures, "outputs": outputs, "pictures": pictures}

if __name__ == "__main__":
    main()
