# SPDX-License-Identifier: MIT
"""Record of a threshold of `tune risk`, and the least numbers of scans that it prints."""

import hashlib
import json
import re
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace

import pytest
from command_line import called, subject
from scans import refused

from salsanext_cli.commands.line.options.option_names import CommandLine
from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.measures.risk_control import needed_scans, useful_scans
from salsanext_cli.core.network.card import RiskThreshold, scan_digest
from salsanext_cli.core.wording import spelled
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.report.tables import needed_scans_table
from salsanext_cli.training.tuning.risk_record import write_risk_record
from salsanext_cli.training.tuning.risk_report import ComputedBy

PAGE_OF_JSON = Path(__file__).parents[3] / "docs/reference/json.md"
PAGE = Path(__file__).parents[3] / "docs/concepts/guarantee.md"


def test_the_record_states_what_the_threshold_is_based_on(world, tmp_path):
    target = tmp_path / "safe.safetensors"
    record = tmp_path / "record.json"
    words = ("--at-most", "90%", "--sequences", "00,08", "--engine", "torch", "--device", "cpu")
    weights = ("--weights", world.network.weights)
    tuned = called("tune", "risk", world.data, target, *words, *weights, "--record", record)
    (line,) = (line for line in tuned.stderr.splitlines() if line.startswith("tune risk: "))
    assert f" → {target}, " in line
    assert line.endswith(f", {record}")
    content = json.loads(record.read_text())
    risk = read_card(target).risk
    assert content["threshold"] == risk.threshold
    assert content["settings"] == risk.settings
    for key, path in {"weights": world.network.weights, "weights_with_threshold": target}.items():
        assert content[key]["sha256"] == hashlib.sha256(Path(path).read_bytes()).hexdigest()
    age = datetime.now(UTC) - datetime.fromisoformat(content["date"])
    assert timedelta(0) <= age < timedelta(minutes=10)
    digests = {scan["scan"]: scan["digest"] for scan in content["scans"]}
    assert digests.keys() == {"00/000000", "08/000000", "08/000001"}
    assert digests["08/000001"] == scan_digest(read_scan(world.scan("08", "000001")))
    assert {part["sequence"] for part in content["check"]["held_out_sequences"]} == {"00", "08"}
    assert content["computed_by"] == {
        "device": "cpu",
        "engine": "torch",
        "precision": world.network.precision,
    }
    assert content["versions"]["torch"] == version("torch")
    assert content["versions"]["salsanext"] == content["version"]
    assert content["machine"]["gpu"] is None
    assert content["machine"]["cpu"]
    documented = PAGE_OF_JSON.read_text("utf-8").partition("## The record of tune risk")[2]
    assert {key for key in content if f"`{key}`" not in documented} == set()
    # An archived record is not replaced, and the refusal comes before the work.
    other = tmp_path / "other.safetensors"
    second = called(
        "tune", "risk", world.data, other, *words, *weights, "--record", record, status=1
    )
    assert subject(second) == str(record)
    assert not other.exists()
    assert json.loads(record.read_text()) == content


def test_a_record_that_was_written_meanwhile_is_kept(weights, tmp_path):
    record = tmp_path / "record.json"
    record.write_text("{}")
    threshold = RiskThreshold(
        kind="least_confidence", threshold=0.5, at_most=0.1, confidence=None, scans=0, sequences=()
    )
    fit = SimpleNamespace(
        scans=(),
        threshold=threshold,
        guarantee="",
        computed_by=ComputedBy(device="cpu", engine="torch", precision="float32"),
        accepted=1.0,
        warnings=(),
        held_out=(),
    )
    facts = {"source": tmp_path, "weights": weights, "target": weights}
    with refused(OutputError, record):
        write_risk_record(record, fit, **facts, overwrite=False)
    assert record.read_text() == "{}"
    write_risk_record(record, fit, **facts, overwrite=True)
    assert json.loads(record.read_text())["at_most"] == 0.1


def test_the_least_numbers_of_the_page_are_those_of_the_bounds():
    rows = re.findall(
        r"^\| (.*(?:--at-most|--confidence).*) \| (\d+) \| (\d+) \|$", PAGE.read_text(), re.M
    )
    assert len(rows) == 7
    for name, scans, drives in rows:
        share = float(re.search(r"(\d+)%", name)[1]) / 100
        if "--confidence" in name:
            assert int(scans) == int(drives) == needed_scans(0.1, share)
        else:
            assert (int(scans), int(drives)) == (
                needed_scans(share, None),
                useful_scans(share, None),
            )


@pytest.mark.parametrize(("at_most", "count"), [(0.1, 6), (0.07, 7)])
def test_the_printed_table_has_the_limit_that_was_asked_for(at_most, count):
    table = needed_scans_table(at_most)
    cells = [cell.plain for cell in table.columns[0].cells]
    assert len(cells) == count
    assert f"{100 * at_most:.3g} % on average" in cells


@pytest.mark.parametrize(("confidence", "count"), [(0.9, 3), (0.85, 4)])
def test_the_printed_table_has_the_confidence_that_was_asked_for(confidence, count):
    with spelled(CommandLine()):
        table = needed_scans_table(0.1, confidence)
    columns = [[cell.plain for cell in column.cells] for column in table.columns]
    rows = [row for row in zip(*columns, strict=True) if "--confidence" in row[0]]
    assert len(rows) == count
    # All n scans are within the limit with chance p^n: the least n makes it at most 1 - p.
    scans = next(n for n in range(1, 1000) if confidence**n <= 1 - confidence)
    assert (f"any limit, --confidence {100 * confidence:g}%", str(scans), str(scans)) in rows


def test_a_refusal_of_too_few_scans_shows_how_many_are_needed(world, tmp_path):
    words = ("tune", "risk", world.data, tmp_path / "safe.safetensors", "--at-most", "2%")
    refusal = called(*words, "--weights", world.network.weights, status=1)
    assert "2 % on average" in refusal.stderr
    assert refusal.stderr.index("Least numbers") < refusal.stderr.index("error: ")
    assert refusal.stdout == ""
    quiet = called(*words, "--weights", world.network.weights, "--quiet", status=1)
    assert subject(quiet) == str(world.data)
