# SPDX-License-Identifier: MIT
"""`--events` of the commands that run over scans."""

import json
from inspect import signature

import pytest
from command_line import every_command, subject
from scans import make_scan, write_bin

from salsanext_cli.commands.line.values.events_option import typed_events
from salsanext_cli.core.errors import UsageError


def test_every_command_with_jobs_or_shards_of_scans_offers_it():
    offering = {
        name
        for name, command in every_command().items()
        if "events" in signature(command).parameters
    }
    assert offering == {
        *("predict", "uncertainty", "project", "knn-refine", "fuse", "eval", "compare", "inspect"),
        *("pick", "convert", "filter", "picture", "export-ply", "export-las", "export-bag"),
        *("report", "view"),
    }


def test_the_lines_name_the_command_and_the_warnings(run, data, weights, tmp_path):
    path, out = tmp_path / "events.jsonl", tmp_path / "out"
    network = ("--weights", weights, "--device", "cpu")
    run("predict", data, out, *network, "--events", path, status=0)
    printed = json.loads(
        run("predict", data, out, *network, "--events", path, "--overwrite", "--json").stdout
    )
    run("eval", out, "--events", path, status=0)
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [line["command"] for line in lines] == [*["predict"] * 4, *["eval"] * 2]
    warned = {(w["code"], name) for w in printed["warnings"] for name in w["scans"]}
    assert warned >= {(code, line["name"]) for line in lines[2:4] for code in line["warnings"]}


def test_a_scan_is_no_file_of_events(run, tmp_path):
    scan = tmp_path / "a.bin"
    write_bin(scan, make_scan())
    before = scan.read_bytes()
    refused = run("inspect", scan, "--events", scan)
    assert (refused.exit_code, subject(refused)) == (1, str(scan))
    assert scan.read_bytes() == before


def test_no_name_is_refused():
    with pytest.raises(UsageError):
        typed_events("")
    assert typed_events(None) is None
