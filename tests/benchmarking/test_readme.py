# SPDX-License-Identifier: MIT
"""The page of benchmarks/ has a row for each script; pages name scripts that exist."""

import re
from importlib.util import find_spec
from pathlib import Path

import guide
import pytest

import benchmarks

FOLDER = Path(benchmarks.__file__).parent
README = FOLDER / "README.md"
ROOMS = ("speed", "gpu", "weights", "studies")
COMMAND = re.compile(r"python -m (benchmarks(?:\.\w+)+)")
FILE = re.compile(r"`(benchmarks/[\w/-]+\.\w+)")


def section_of(room: str) -> str:
    """Return the text about a room."""
    _, _, rest = README.read_text("utf-8").partition(f"\n## `{room}/`")
    return rest.partition("\n## ")[0]


@pytest.mark.parametrize("room", ROOMS)
def test_every_script_has_a_row_and_every_module_a_mention(room):
    section = section_of(room)
    rows = re.findall(r"^\| `(\w+)` \| .+\? \| `python -m benchmarks\.(\w+)\.(\w+)", section, re.M)
    assert all(name == module and place == room for name, place, module in rows)
    modules = {path.stem: path.read_text("utf-8") for path in (FOLDER / room).glob("*.py")}
    scripts = {name for name, text in modules.items() if "\nRun: python -m " in text}
    assert {name for name, _, _ in rows} == scripts
    assert [name for name in modules if f"`{name}`" not in section] == []


def test_no_script_lies_outside_the_rooms():
    assert {path.name for path in FOLDER.iterdir() if path.is_dir()} - {"__pycache__"} == {*ROOMS}
    shared_by_rooms = {path.stem for path in FOLDER.glob("*.py")}
    assert shared_by_rooms == {"__init__", "commands", "finished_scans", "processes"}


def test_pages_and_scripts_name_scripts_that_exist():
    for page in (*guide.PAGES, README, *sorted(FOLDER.rglob("*.py"))):
        text = page.read_text("utf-8")
        unknown = [name for name in COMMAND.findall(text) if find_spec(name) is None]
        absent = [name for name in FILE.findall(text) if not (FOLDER.parent / name).is_file()]
        assert (unknown, absent) == ([], []), page


def test_links_of_the_readme_lead_somewhere():
    targets = re.findall(r"\]\(([^)#]+)", README.read_text("utf-8"))
    assert len(targets) > 20
    assert [target for target in targets if not (FOLDER / target).exists()] == []
