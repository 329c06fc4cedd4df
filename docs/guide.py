# SPDX-License-Identifier: MIT
"""Run the commands of a page and replace the outputs and figures that it shows.

HTML comments, which readers do not see, control how a page is run:

    <!-- run: COMMAND -->      a hidden command, such as copying labels in place of a person
    <!-- not run: REASON -->   the next `sh` or `python` block is not run
    <!-- output -->            the next `text` block is the output of the block above it;
                               `first 5`, `last 5` or `first 3, last 5` limits its lines
    <!-- GROUP.KEY -->82.1<!-- / -->   a figure of docs/figures.json
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

DOCS = Path(__file__).parent
FIGURES = DOCS / "figures.json"
PAGES = [DOCS.parent / "README.md", *sorted(DOCS.rglob("*.md"))]
COLUMNS = 88
"""Width of captured outputs, which fit the column of text of the site."""

BLOCK = re.compile(
    r"^<!-- run: (?P<hidden>.+?) -->$"
    r"|^(?:<!-- not run: (?P<reason>.+?) -->\n+)?```(?P<language>\w*)\n(?P<body>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
OUTPUT = re.compile(r"<!-- output(?P<limit>[^\n]*?) -->\s*\Z")
PROGRESS = re.compile(r": \d+/\d+ .* left$")
FIGURE = re.compile(r"<!-- ([a-z0-9_]+\.[a-z0-9_]+) -->(.*?)<!-- / -->", re.DOTALL)


class CommandError(Exception):
    """A command of a page ended with an error."""


class Block(NamedTuple):
    """A fenced block of a page, or a hidden command."""

    language: str
    body: str
    start: int
    """Offset of the body in the text of the page."""
    run: bool
    output: str | None
    """Which lines of the last output the block shows; None if it is no output."""


def blocks(text: str) -> list[Block]:
    """Return the blocks of a page in their order."""
    found = []
    for match in BLOCK.finditer(text):
        hidden, language = match["hidden"], match["language"]
        output = OUTPUT.search(text, 0, match.start())
        found.append(
            Block(
                "sh" if hidden else language,
                hidden or match["body"],
                match.start("hidden" if hidden else "body"),
                match["reason"] is None,
                output["limit"].strip() if output and not hidden else None,
            )
        )
    return found


def outputs(text: str, folder: Path) -> str:
    """Run the commands of a page in a folder; return the page with their outputs."""
    pieces, done, output = [], 0, ""
    for block in blocks(text):
        if block.language in ("sh", "python") and block.run:
            output = run(block.body, folder, block.language)
        elif block.output is not None:
            pieces += [text[done : block.start], limited(output, block.output)]
            done = block.start + len(block.body)
    return "".join([*pieces, text[done:]])


def run(commands: str, folder: Path, language: str = "sh") -> str:
    """Run commands of the shell, or Python code, in a folder; return what they print."""
    shell = ["bash", "-euo", "pipefail", "-c"] if language == "sh" else [sys.executable, "-c"]
    tools = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    settings = {"PATH": tools, "COLUMNS": str(COLUMNS), "NO_COLOR": "1", "TERM": "dumb"}
    # Otherwise the lines of stdout would come after all lines of stderr.
    settings["PYTHONUNBUFFERED"] = "1"
    environment = {k: v for k, v in os.environ.items() if not k.startswith("SALSANEXT_")}
    done = subprocess.run(
        [*shell, commands],
        cwd=folder,
        env=environment | settings,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if done.returncode:
        raise CommandError(f"{commands}\n{done.stdout}")
    lines = (line.rstrip() for line in done.stdout.splitlines())
    return "".join(f"{line}\n" for line in lines if not PROGRESS.search(line))


def limited(output: str, limit: str) -> str:
    """Return the first and last lines of an output, as a limit such as `first 3, last 5` asks."""
    lines = output.splitlines(keepends=True)
    numbers = {key: int(value) for key, value in re.findall(r"(first|last) (\d+)", limit)}
    if not numbers or sum(numbers.values()) >= len(lines):
        return output
    head, tail = lines[: numbers.get("first", 0)], lines[len(lines) - numbers.get("last", 0) :]
    return "".join([*head, "…\n", *tail])


def stored_figures() -> dict[str, dict[str, Any]]:
    """Return the measured figures: for each group its weights, its date and its values."""
    return json.loads(FIGURES.read_text("utf-8")) if FIGURES.exists() else {}


def with_figures(text: str, figures: dict[str, dict[str, Any]]) -> str:
    """Return a page with the stored values of the figures that it shows."""

    def value(match: re.Match[str]) -> str:
        group, key = match[1].split(".")
        stored = figures.get(group, {}).get(key, match[2])
        return f"<!-- {match[1]} -->{stored}<!-- / -->"

    return FIGURE.sub(value, text)
