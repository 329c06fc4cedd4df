# SPDX-License-Identifier: MIT
"""The way of one scan through `predict` is the one that docs/development.md shows."""

import re
import sys
from pathlib import Path

import pytest

import salsanext_cli
from salsanext_cli.stages import predict as stage

PACKAGE = Path(salsanext_cli.__file__).parent
PAGE = PACKAGE.parent / "docs/development.md"


def documented() -> list[str]:
    """Return the files that the page lists for each scan, in order."""
    text = PAGE.read_text("utf-8").partition("Once per scan")[2].partition("\n\n`uncertainty`")[0]
    return re.findall(r"^\d+\. `(\S+\.py)`", text, re.MULTILINE)


def test_the_documented_files_are_visited_in_this_order(
    world, monkeypatch: pytest.MonkeyPatch
) -> None:
    visited: list[str] = []

    def note(frame, event: str, _: object) -> None:
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.is_relative_to(PACKAGE):
            name = path.relative_to(PACKAGE).as_posix()
            if name not in visited:
                visited.append(name)

    original = stage.predict_scan

    def followed(*arguments, **options):
        sys.setprofile(note)
        try:
            return original(*arguments, **options)
        finally:
            sys.setprofile(None)

    monkeypatch.setattr(stage, "predict_scan", followed)
    stage.predict_scans(world.scan(), world.out, network=world.network)
    files = documented()
    assert len(files) == len(set(files)) > 8
    assert [name for name in visited if name in files] == files
