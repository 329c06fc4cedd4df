# SPDX-License-Identifier: MIT
"""Events of runs: a line for each scan that ends, at the end of a file of events only."""

import json
import os
import threading
from datetime import UTC, datetime, timedelta

import pytest
from worker_runs import run
from worker_tasks import Write, scans_of

from salsanext_cli.core.errors import FormatError, OutputError
from salsanext_cli.runs.loop.event_file import EventFile, EventLog, opened_events


def lines_of(path):
    return [json.loads(line) for line in path.read_text("ascii").splitlines()]


@pytest.mark.parametrize("options", [{}, {"jobs": 2}], ids=["1", "2"])
def test_each_scan_gets_a_line_when_it_ends(tmp_path, options):
    path = tmp_path / "new/events.jsonl"
    events = EventFile(path=path, command="predict")
    begin = datetime.now(UTC) - timedelta(seconds=1)
    run(Write(tmp_path), scans_of("a", "bad", "c"), events=events, **options)
    lines = lines_of(path)
    assert {line["name"]: line["state"] for line in lines} == {
        "s/a": "done",
        "s/bad": "failed",
        "s/c": "done",
    }
    assert [line["count"] for line in lines] == [1, 2, 3]
    assert {(line["schema"], line["command"], line["total"]) for line in lines} == {
        (1, "predict", 3)
    }
    assert all(begin <= datetime.fromisoformat(line["time"]) <= datetime.now(UTC) for line in lines)
    failed = next(line for line in lines if line["state"] == "failed")
    assert failed["scan"] == "/scans/bad.bin"
    assert failed["reason"] == "/scans/bad.bin: cut off"
    assert (failed["code"], failed["hint"], failed["warnings"]) == ("format", "", [])
    for line in lines:
        assert ({"reason", "hint", "code"} <= line.keys()) == (line is failed)
        assert bool({"reason", "hint", "code"} & line.keys()) == (line is failed)
    # A second run appends the scans that it attempts.
    run(Write(tmp_path, peaceful=True), scans_of("a", "bad", "c", "d"), events=events, **options)
    added = lines_of(path)[3:]
    assert sorted(line["name"] for line in added) == ["s/bad", "s/d"]
    assert [(line["count"], line["total"]) for line in added] == [(1, 2), (2, 2)]


def test_a_run_without_scans_to_work_on_has_a_line(tmp_path):
    """Another program may wait for the file, or for a line about this run."""
    path = tmp_path / "events.jsonl"
    events = EventFile(path=path, command="predict")
    run(Write(tmp_path), scans_of("a", "b"))
    for lines in (1, 2):
        assert run(Write(tmp_path), scans_of("a", "b"), events=events).skipped == 2
        assert len(lines_of(path)) == lines
    last = lines_of(path)[-1]
    assert (last["scan"], last["name"], last["state"]) == (None, None, "none")
    assert (last["count"], last["total"], last["command"]) == (0, 0, "predict")
    run(Write(tmp_path), scans_of("c"), events=events)
    assert [line["state"] for line in lines_of(path)] == ["none", "none", "done"]


def test_the_result_of_a_scan_exists_before_its_line(tmp_path):
    """Another program may read the result as soon as it sees the line."""
    seen = []

    def look(done, _):
        if done:
            last = lines_of(tmp_path / "events.jsonl")[-1]
            seen.append((last["count"], (tmp_path / last["name"]).exists()))

    events = EventFile(path=tmp_path / "events.jsonl")
    run(Write(tmp_path), scans_of("a", "b"), events=events, progress=look)
    assert seen == [(1, True), (2, True)]


def test_the_scan_that_stops_a_run_has_a_line(tmp_path):
    path = tmp_path / "events.jsonl"
    with pytest.raises(FormatError):
        run(Write(tmp_path), scans_of("bad"), events=EventFile(path=path), on_error="stop")
    assert [line["state"] for line in lines_of(path)] == ["failed"]


@pytest.mark.parametrize(
    "content", [b"mine\n", b"\x00\x01", b"[1]\n", b'{"scan": 1}\n', b"[" * 100_000, b"\n"]
)
def test_a_file_of_something_else_is_refused_and_stays(tmp_path, content):
    path = tmp_path / "scan.bin"
    path.write_bytes(content)
    with pytest.raises(OutputError) as caught:
        EventFile(path=path)
    assert caught.value.subject == str(path)
    assert path.read_bytes() == content


def test_a_folder_is_refused_when_the_run_begins(tmp_path):
    with pytest.raises(OutputError):
        run(Write(tmp_path / "out"), scans_of("a"), events=EventFile(path=tmp_path))
    assert not (tmp_path / "out").exists()


def test_a_line_that_was_cut_off_does_not_join_the_next_one(tmp_path):
    path = tmp_path / "events.jsonl"
    events = EventFile(path=path)
    run(Write(tmp_path), scans_of("a"), events=events)
    with path.open("ab") as file:
        file.write(b'{"schema": 1, "sc')
    run(Write(tmp_path), scans_of("b"), events=events)
    first, cut, last = path.read_text().splitlines()
    assert (json.loads(first)["name"], json.loads(last)["name"]) == ("s/a", "s/b")
    assert cut == '{"schema": 1, "sc'


def test_a_pipe_gets_all_lines_of_a_run_without_an_end_between_them(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    texts = []
    reader = threading.Thread(target=lambda: texts.append(path.read_text()), daemon=True)
    reader.start()
    run(Write(tmp_path / "out"), scans_of("a", "b"), events=EventFile(path=path))
    reader.join(10)
    assert [json.loads(line)["name"] for line in texts[0].splitlines()] == ["s/a", "s/b"]


def test_scans_that_end_together_get_their_lines_together(tmp_path):
    path = tmp_path / "events.jsonl"
    scans = scans_of("a", "b")
    with opened_events(EventFile(path=path), 6) as events:
        with events.together(scans):
            assert path.read_bytes() == b""
        with pytest.raises(FormatError), events.together(scans):
            raise FormatError("bag", "cut off")
        with pytest.raises(KeyboardInterrupt), events.together(scans):
            raise KeyboardInterrupt
    assert [(line["count"], line["state"]) for line in lines_of(path)] == [
        (1, "done"),
        (2, "done"),
        (3, "failed"),
        (4, "failed"),
    ]


def test_names_that_are_no_text_are_escaped(tmp_path):
    lines = []
    EventLog(append=lines.append).add(scans_of("a\udcff")[0])
    assert json.loads(lines[0])["name"] == "s/a\\xff"
