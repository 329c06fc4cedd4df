# SPDX-License-Identifier: MIT
"""End of a run: next command, warnings, skipped scans, path of the page."""

import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from command_line import only_json, subject
from evaluation_runs import CAR, ROAD, World
from scans import SMALL, make_scan, write_bin, write_sequence

from salsanext_cli import label_space
from salsanext_cli.commands.line.commands.predict import MANY_SCANS, _advice, _numbers, _with_fusion
from salsanext_cli.commands.line.output.next_command import command_on_labels, next_command
from salsanext_cli.commands.line.output.summary import _lines_on_scans, print_failures, scans_data
from salsanext_cli.commands.stages.predict import PredictOutcome
from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.checks.label_checks import LABELS_HINT
from salsanext_cli.core.engines import device
from salsanext_cli.core.network.card import RiskThreshold
from salsanext_cli.io.formats.kitti_labels import write_labels
from salsanext_cli.runs.loop.run import Failure, Outcome, RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.records.stage_settings import PredictSettings
from salsanext_cli.runs.results.manifest import Manifest, StageRecord, settings_json
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.summary.run_counts import RunCounts
from salsanext_cli.runs.summary.run_summary import RunSummary


@pytest.mark.parametrize(
    "options",
    [
        "",
        "--sensor 'my sensor.toml' --width 64 --min-range 2 --ego none",
        "--columns x,y,z,intensity --intensity-field intensity",
    ],
)
def test_the_next_commands_lead_from_scans_to_scores(
    run, data, weights, tmp_path, monkeypatch, options
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my sensor.toml").write_text(replace(SMALL, fov_up=4.0).to_toml())
    out = tmp_path / "my out"
    named = shlex.split(options)
    printed = only_json(run("project", data, out, "--weights", weights, *named, "--json"))
    following = shlex.split(printed["next"])
    words = ["salsanext", "predict", str(out), str(out), "--weights", str(weights)]
    assert following[: len(words)] == words
    assert {*following[len(words) :]} == {*named}
    commands = []
    while following := printed.get("next"):
        _, *words = shlex.split(following)
        commands.append(words[0])
        result = run(*words, "--json", status=0)
        printed = only_json(result)
    assert commands == ["predict", "knn-refine", "eval"]


@pytest.mark.parametrize("command", ["predict", "uncertainty"])
def test_a_single_scan_that_fails_prints_nothing_about_weights_and_sensor(
    run, weights, tmp_path, command
):
    broken = tmp_path / "broken.bin"
    broken.write_bytes(bytes(17))
    words = (command, broken, tmp_path / "out", "--weights", weights)
    result = run(*words, status=1)
    starts = [line.partition(":")[0] for line in result.stderr.splitlines()]
    assert starts == ["error", "hint", command]
    printed = only_json(run(*words, "--json", status=1))
    assert printed["failed"] == 1
    assert printed["sensor"] is None
    write_bin(broken, make_scan())
    result = run(*words, status=0)
    starts = [line.partition(":")[0] for line in result.stderr.splitlines()]
    assert any(start.startswith(str(weights)) for start in starts)
    assert "image" in starts


def outcome_of(summary=None, done=1, skipped=0):
    """Return the outcome of a run."""
    return Outcome(skipped=skipped, failures=(), done=done, summary=summary)


def test_rejected_points_are_counted():
    summary = RunSummary(
        sensor=SMALL,
        space=label_space(),
        counts=RunCounts(class_points=np.array([1500, 500] + [0] * 18)),
    )
    summary.counts.judged_points, summary.counts.rejected_points = 1600, 1200
    outcome = PredictOutcome.from_run(outcome_of(summary, skipped=2), rejected_points=1200)
    numbers = _numbers(outcome, 0.5, "faster: …")
    reason = "probability of error above 0.5; 2 done already not counted"
    line = f"1,200 points (75.0 % of the points with a label) rejected: {reason}"
    assert numbers.lines == [line, "faster: …"]
    assert numbers.data == {"rejected_points": 1200, "rejected_share": 0.75}
    (line,) = _numbers(replace(outcome, skipped=0), "risk", "").lines
    assert line.endswith(" rejected: above the threshold of `tune risk`")
    none = _numbers(replace(outcome, rejected_points=None), None, "")
    assert (none.data, none.lines) == ({}, [])


@pytest.mark.parametrize(
    ("split", "done", "expected"),
    [
        ("valid", 1, "salsanext report 'a b'"),
        ("test", 1, "salsanext submit 'a b' submission.zip"),
        ("test", 0, None),
    ],
)
def test_the_next_command_uses_the_labels(split, done, expected, tmp_path):
    out = Path("a b")
    summary = RunSummary(sensor=SMALL, space=label_space())
    assert command_on_labels(outcome_of(summary, done), out, split) == expected
    (file,) = find_scans(write_sequence(tmp_path / "labelled/00", ["0"]))
    labelled = replace(summary, scans=[file])
    command = command_on_labels(outcome_of(labelled, done), out, split)
    assert command == ("salsanext eval 'a b'" if done else None)
    pixels = RunSummary(sensor=SMALL)
    command = command_on_labels(outcome_of(pixels, done), out, split)
    assert command == ("salsanext knn-refine 'a b'" if done else None)


def test_only_labels_in_the_classes_of_the_benchmark_are_submitted(tmp_path):
    out = Path("a b")
    merged = RunSummary(sensor=SMALL, space=label_space("coarse"))
    assert command_on_labels(outcome_of(merged), out, "test") == "salsanext report 'a b'"
    # A data set with the test split of another label space has another benchmark.
    space = replace(label_space("coarse"), splits={"test": ("90",)})
    command = command_on_labels(outcome_of(RunSummary(sensor=SMALL, space=space)), out, "test")
    assert command == "salsanext submit 'a b' submission.zip"
    (file,) = find_scans(write_sequence(tmp_path / "sequences/90", labels=False).parents[1])
    (tmp_path / "labels.yaml").write_text(yaml.safe_dump(label_space().to_dict()))
    described = RunSummary(sensor=SMALL, space=space, scans=[file])
    assert command_on_labels(outcome_of(described), out, "test") == "salsanext report 'a b'"


def test_a_run_without_results_has_no_next_command():
    words = ["predict", Path("a b")]
    assert next_command(outcome_of(done=0, skipped=1), words) == "salsanext predict 'a b'"
    assert next_command(outcome_of(done=0), words) is None
    assert command_on_labels(outcome_of(), Path("a b"), None) is None


@pytest.mark.parametrize("count", [1, 2])
def test_a_warning_is_printed_once(run, data, tmp_path, count):
    sensor = tmp_path / "upwards.toml"
    sensor.write_text("fov_up = 30.0\nfov_down = -2.0\nheight = 16\nwidth = 128\n")
    given = ("project", data, tmp_path / "out", "--sensor", sensor, "--limit", count)
    inspected = ("inspect", data, "--sensor", sensor, "--limit", count)
    # The second run prints the recorded warning.
    for arguments in (given, given, inspected):
        result = run(*arguments, status=0)
        assert result.stderr.count("(out-of-view)") == 1
        assert result.stderr.count("out-of-view in 1 more scan: 08/000001") == count - 1
        assert result.stderr.count("out-of-view") == count


def test_eval_is_next_only_if_it_can_compare_the_labels(tmp_path):
    """Label files of another data set do not lead to a command that fails."""
    (file,) = find_scans(write_sequence(tmp_path / "00", ["0"]))
    outcome = outcome_of(RunSummary(sensor=SMALL, space=label_space(), scans=[file]))
    assert command_on_labels(outcome, Path("out"), None) == "salsanext eval out"
    unknown_id = np.full(1500, 24, np.uint32)
    write_labels(file.label_path, unknown_id)
    assert command_on_labels(outcome, Path("out"), None) == "salsanext report out"


def test_the_line_of_the_image_names_the_source_of_its_field_of_view():
    fitted = replace(SMALL, fov_up=SMALL.fov_up + 7)
    mounted = replace(SMALL, name="fitted", origin=(0.0, 0.0, 1.0))
    sources = {
        "(of the weights)": SMALL,
        "(fitted)": fitted,
        "(mounting fitted)": mounted,
        "(sensor hdl32)": replace(fitted, name="hdl32"),
    }
    for source, sensor in sources.items():
        (line,) = _lines_on_scans(RunSummary(sensor=sensor, trained=SMALL))
        assert line.startswith(f"image: {SMALL.height}×{SMALL.width}, ")
        assert line.endswith(source)
    (line,) = _lines_on_scans(RunSummary(sensor=SMALL))
    assert "(" not in line


def test_equal_sensors_are_printed_once():
    """Sensors may differ in what the line does not show, such as the fit of the intensity."""
    darker, leaning = replace(SMALL, row_gaps=0.5), replace(SMALL, up=(0.5, 0.0, 0.9))
    for others, count in (((darker,), 1), ((darker, leaning), 2)):
        lines = list(_lines_on_scans(RunSummary(sensor=replace(SMALL, others=others))))
        assert len([line for line in lines if line.startswith("image: ")]) == count


def test_without_scans_no_folder_is_read_or_made(run, data, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    write_bin(tmp_path / "here/0.bin", make_scan())
    for command in ("predict", "project", "uncertainty", "inspect"):
        result = run(command)
        assert (result.exit_code, subject(result)) == (2, "SCANS")
    assert [path.name for path in Path().iterdir()] == ["0.bin"]
    monkeypatch.chdir(data)
    assert run("inspect").exit_code == 0


@pytest.fixture
def world(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    world = World(tmp_path)
    world.add("000000", [CAR, ROAD], [CAR, CAR])
    world.add("000001", [CAR, ROAD], [CAR, ROAD])
    return world


def test_report_prints_the_path_of_the_page(run, world):
    given = ("report", str(world.out), "--dataset", str(world.dataset))
    result = run(*given, "--json", status=0)
    printed = only_json(result)
    assert printed["page"] == str(world.out / "report.html")
    assert printed["accuracy"] == 3 / 4
    assert "report: 2 scans" in result.stderr
    assert run(*given, "--scans", "9").exit_code == 2
    assert run("report", "nowhere").exit_code == 1
    result = run(*given, "--scans", "08/000001", "--quiet")
    assert (result.exit_code, result.output) == (0, "")


@pytest.mark.parametrize(
    ("changes", "flags", "named"),
    [
        ({}, "avx2", True),
        ({"ranges": False}, "avx2", False),
        ({"guarantee": RiskThreshold("error", 0.2, 0.1, None, 12, ("00",))}, "avx2", False),
        ({"done": MANY_SCANS}, "avx2", False),
        ({"precision": "float32"}, "avx2", False),
        ({"engine": "torch"}, "avx2", False),
        ({}, "avx2 amx_bf16", False),
        ({}, "", False),
    ],
)
def test_a_long_run_without_bfloat16_names_int8(
    changes, flags, named, weights, tmp_path, monkeypatch
):
    defaults = {"done": MANY_SCANS + 1, "precision": "auto", "engine": "openvino", "ranges": True}
    given = {**defaults, "guarantee": None, **changes}
    recorded = PredictSettings(
        precision="float32", engine=given["engine"], guarantee=given["guarantee"]
    )
    record = StageRecord(stage="predict", settings=settings_json(recorded))
    Manifest(tmp_path).write(record)
    monkeypatch.setattr(device, "processor_flags", lambda: frozenset(flags.split()))
    for variable in device.ISA_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    settings = NetworkSettings(weights, precision=given["precision"])
    outcome = PredictOutcome.from_run(
        outcome_of(done=given["done"]), has_int8_ranges=given["ranges"]
    )
    advice = _advice(settings, outcome, tmp_path)
    assert ("--precision int8" in advice) == named


def failed(stem, problem, hint=""):
    """Return the failure of a scan."""
    path = Path(f"/drive/{stem}.bin")
    return Failure(
        scan=ScanFile(sequence="00", stem=stem, path=path),
        reason=f"{path}: {problem}",
        hint=hint,
        code="format",
    )


def test_equal_failures_of_many_scans_are_one_line_with_their_number(capsys):
    equal = [failed(f"{number}", "is empty", "copy it") for number in range(8)]
    print_failures((*equal, failed("x", "is cut off"), failed("y", "is cut off")))
    first, hint, *others = capsys.readouterr().err.splitlines()
    assert first == "error: 8 scans: is empty: 00/0, 00/1, 00/2 and 5 more"
    assert hint == "hint: copy it"
    assert others == ["error: /drive/x.bin: is cut off", "error: /drive/y.bin: is cut off"]


def test_the_line_of_unlabelled_points_states_their_causes():
    points = np.array([60, 40] + [0] * 18)
    summary = RunSummary(sensor=SMALL, space=label_space(), counts=RunCounts(class_points=points))
    summary.counts.unmeasured_points, summary.counts.rejected_points = 30, 20
    summary.counts.ego_points, summary.counts.checked_points = 10, 100
    (line,) = (line for line in _lines_on_scans(summary) if line.startswith("unlabelled: "))
    assert line.startswith("unlabelled: 60.0 % of all points (30.0 % without a measurement; ")
    assert "; 10.0 % on " in line
    assert line.endswith("; 20.0 % rejected)")
    assert scans_data(summary, has_results=True)["unmeasured_share"] == 0.3


def test_warnings_of_fused_labels_join_those_of_single_scans(tmp_path, monkeypatch):
    predicted, fused = (RunSummary(sensor=SMALL, space=label_space()) for _ in range(2))
    for summary, stem in ((predicted, "a"), (fused, "b")):
        summary.findings.add(f"08/{stem}", Finding("one-class", f"{stem} is road", LABELS_HINT))
    stage = "salsanext_cli.commands.stages.fuse.fuse_results"
    monkeypatch.setattr(stage, lambda *_, **__: outcome_of(fused))
    outcome = PredictOutcome.from_run(outcome_of(predicted))
    output = SimpleNamespace(print=print, quiet=True)
    target = tmp_path / "fused"
    both = _with_fusion(outcome, tmp_path, target, ScanSelection(), RunOptions(), output)
    (warning,) = both.summary.warnings()
    assert (warning.message, warning.scans) == ("a is road", ["08/a", "08/b"])
