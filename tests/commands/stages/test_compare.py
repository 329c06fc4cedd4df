# SPDX-License-Identifier: MIT
import json
import shutil
from io import StringIO

import numpy as np
import pytest
from calls import calls_of
from evaluation_runs import CAR, ROAD, SPACE, UNKNOWN, World
from matplotlib.image import imread
from rich.console import Console
from scans import files_below, refused
from worker_tasks import attempts_in_process

from salsanext_cli import label_space, read_scan, sensor
from salsanext_cli.commands.stages.compare import compare
from salsanext_cli.commands.stages.evaluate import evaluate
from salsanext_cli.commands.stages.report import report
from salsanext_cli.core.errors import LabelError, NoInputError, OutputError, UsageError
from salsanext_cli.core.network.card import scan_digest
from salsanext_cli.report.colours import screen_colours
from salsanext_cli.report.page.other_run import SCORES
from salsanext_cli.report.run_change_tables import comparison_tables
from salsanext_cli.report.run_changes import CHANGES
from salsanext_cli.report.scan_pictures import scan_picture
from salsanext_cli.runs.loop.cluster import attempts
from salsanext_cli.runs.loop.run_folders import RunFolders
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.summary.run_comparison import FILES, recorded_comparison

TREE = 70
SCANS = 6


@pytest.fixture
def runs(tmp_path):
    """Return two runs on drives of one scan with truth; the second one is better for cars."""
    worlds = World(tmp_path), World(tmp_path)
    worlds[1].out = tmp_path / "after"
    for number in range(SCANS):
        truth = [CAR, ROAD, ROAD, TREE, 0] * 4
        before = np.where(np.arange(20) < 2 + number, CAR, truth)
        for world, predicted in zip(worlds, (before, truth), strict=True):
            predictions = np.where(predicted == 0, ROAD, predicted)
            world.add("0", truth, predictions, sequence=f"{number:02}")
    return worlds


def compared(runs, **query):
    before, after = runs
    return compare(before.out, after.out, query=ResultQuery(before.dataset, **query))


def record(world, space=SPACE, **settings):
    """Write a record of `predict`."""
    settings |= {"label_space": space.to_dict(), "sensor": sensor("hdl64").to_dict()}
    content = {"stage": "predict", "settings": settings, "writes": ["predictions"], "scans": {}}
    (world.out / "predict.json").write_text(json.dumps(content))


def without_truth(runs):
    for path in runs[0].dataset.rglob("*.label"):
        path.unlink()


def test_scores_are_those_of_eval(runs):
    outcome = compared(runs)
    assert outcome.failures == ()
    found = outcome.comparison
    query = ResultQuery(runs[0].dataset)
    before, after = (evaluate(world.out, query=query).scores for world in runs)
    assert (found.accuracy.before, found.accuracy.after) == (before.accuracy, after.accuracy)
    assert found.iou_mean.before == before.iou_mean_present
    assert found.iou_mean.after == after.iou_mean_present
    ious = {c.name: c.iou for c in found.classes}
    for scores, end in ((before, "before"), (after, "after")):
        for c in scores.classes:
            if c.points:
                assert getattr(ious[c.name], end) == c.iou
    assert found.accuracy.is_clear
    assert 0 < found.accuracy.low <= found.accuracy.change <= found.accuracy.high
    assert (found.scans, found.scored, found.parts) == (SCANS, SCANS, SCANS)


def test_changed_labels_are_those_of_a_slow_loop(runs):
    without_truth(runs)
    found = compared(runs).comparison
    assert (found.accuracy, found.scored) == (None, 0)
    turns, same, points, changed = {}, 0, 0, {}
    for number in range(SCANS):
        labels = [
            np.fromfile(output_path(world.out, f"{number:02}", "predictions", "0"), np.uint32)
            for world in runs
        ]
        for before, after in zip(*labels, strict=True):
            points += 1
            same += before == after
            if before != after:
                turns[before, after] = turns.get((before, after), 0) + 1
                name = f"{number:02}/0"
                changed[name] = changed.get(name, 0) + 1
    names = SPACE.labels
    assert {names_of(change): change.points for change in found.label_changes} == {
        (names[a], names[b]): count for (a, b), count in turns.items()
    }
    assert found.agreement == pytest.approx(same / points)
    assert [c.scan for c in found.most_changed] == sorted(changed, key=lambda name: -changed[name])
    assert found.most_changed[0].changed == pytest.approx(max(changed.values()) / 20)
    (car,) = (c for c in found.classes if c.name == "car")
    assert car.iou is None
    assert 0 < car.same < 1


def names_of(change):
    return change.before, change.after


def test_the_record_is_read_again_until_the_labels_change(runs):
    for world in runs:
        record(world)
    found = compared(runs).comparison
    assert recorded_comparison(runs[1].out) == found
    assert recorded_comparison(runs[0].out) is None
    for world in runs:
        record(world, temperature=2.0)
        assert recorded_comparison(runs[1].out) is None
        record(world)
        assert recorded_comparison(runs[1].out) == found
    shutil.move(runs[0].out, runs[0].out.with_name("moved"))
    assert recorded_comparison(runs[1].out) == found
    (runs[1].out / "compare.json").write_text("{}")
    assert recorded_comparison(runs[1].out) is None


def test_files_are_replaced_unless_they_were_changed(runs):
    compared(runs)
    before = files_below(runs[1].out)
    assert {*FILES} <= before.keys()
    compared(runs)
    assert files_below(runs[1].out) == before
    (runs[1].out / "compare.json").write_text("{}")
    with refused(OutputError, runs[1].out / "compare.json"):
        compared(runs)


def test_equal_runs_have_neither_changes_nor_a_changed_scan(runs):
    compared(runs)
    shutil.rmtree(runs[1].out / "sequences")
    shutil.copytree(runs[0].out / "sequences", runs[1].out / "sequences")
    found = compared(runs).comparison
    assert (found.agreement, found.label_changes, found.most_changed) == (1, (), ())
    assert not found.accuracy.is_clear
    assert not (runs[1].out / "compare_scan.png").exists()
    text = printed(found)
    assert "100.0 % of the labels are the same" in text
    assert "Most changed scans" not in text


def printed(comparison):
    console = Console(record=True, file=StringIO(), width=120)
    console.print(comparison_tables(comparison))
    return console.export_text()


def test_tables_have_scores_changes_and_scans(runs):
    found = compared(runs).comparison
    text = printed(found)
    row = next(line.strip("│ ") for line in text.splitlines() if line.strip("│ ")[:8] == "accuracy")
    accuracy = found.accuracy
    numbers = [accuracy.before, accuracy.after, accuracy.change, accuracy.low, accuracy.high]
    printed_numbers = [float(word) for word in row.split() if word[-1].isdigit()]
    assert printed_numbers == pytest.approx(100 * np.array(numbers), abs=0.051)
    assert row.split()[-1] == "clear"
    scans = text.partition("Most changed scans")[2].split()
    assert [word for word in scans if "/" in word] == [c.scan for c in found.most_changed]
    for words in ("mean IoU, 3 classes", "5 scores judged"):
        assert words in text


def test_runs_that_cannot_be_compared_are_refused(runs, tmp_path):
    before, after = runs
    with refused(UsageError, before.out):
        compare(before.out, before.out, query=ResultQuery(before.dataset))
    record(before)
    record(after, space=label_space("coarse"))
    with refused(UsageError, after.out):
        compared(runs)
    assert compared(runs, classes=label_space("coarse")).comparison.label_space == "coarse"
    record(after, reject=0.1, reject_by="error")
    with refused(UsageError, after.out):
        compared(runs)
    record(after)
    output_path(after.out, "00", "predictions", "0").unlink()
    with refused(UsageError, after.out) as raised:
        compared(runs)
    assert "00/0" in raised.value.problem
    # A common choice of scans can be compared.
    of_both = compared(runs, selection=ScanSelection(sequences=("01",)))
    assert (of_both.comparison.scans, of_both.comparison.accuracy.low) == (1, None)
    with pytest.raises(NoInputError):
        compare(before.out, tmp_path / "nowhere", query=ResultQuery(before.dataset))


def test_scans_that_a_run_was_trained_on_are_not_scored(runs, caplog):
    files = find_scans(runs[0].dataset)
    runs[0].add("0", [CAR, ROAD], [CAR, ROAD], sequence="07")
    runs[1].add("0", [CAR, ROAD], [CAR, CAR], sequence="07")
    record(runs[0])
    # The others have equal points, and are one scan to the digest.
    record(runs[1], trained_on=scan_digest(read_scan(files[0].path)))
    found = compared(runs).comparison
    assert (found.scans, found.scored, found.training_scans) == (SCANS + 1, 1, SCANS)
    assert found.accuracy.after == 0.5
    assert "6 of 7" in caplog.text
    for world in runs:
        output_path(world.out, "07", "predictions", "0").unlink()
    with refused(LabelError, runs[1].out):
        compared(runs)


def test_a_missing_record_of_training_scans_is_stated(runs, caplog):
    for world in runs:
        record(world)
    name = f"digests-{16 * '0'}.digests"
    record(runs[0], trained_on=name)
    found = compared(runs).comparison
    assert (found.training_scans, found.scored) == (None, SCANS)
    (warning,) = (r.getMessage() for r in caplog.records if name in r.getMessage())
    assert warning.startswith(str(runs[0].out / name))
    assert "may have been trained on" in " ".join(printed(found).split())
    assert "may have been trained on" in page(runs)
    assert recorded_comparison(runs[1].out) == found


def test_unknown_ids_are_counted(runs, caplog):
    runs[0].add("0", [CAR, ROAD, ROAD, UNKNOWN], [CAR, ROAD, ROAD, ROAD], sequence="07")
    runs[1].add("0", None, [CAR, ROAD, UNKNOWN + 1, UNKNOWN + 1], sequence="07")
    found = compared(runs).comparison
    assert found.unknown_ids == {
        "truth": {f"{UNKNOWN}": 1},
        "before": {},
        "after": {f"{UNKNOWN + 1}": 2},
    }
    assert f"labels: unknown ids {UNKNOWN} (1×)" in caplog.text
    assert f"second run: unknown ids {UNKNOWN + 1} (2×)" in caplog.text


def test_scans_that_both_runs_lack_are_missing(runs):
    for world in runs:
        world.add("0", [CAR], [CAR], sequence="07")
        world.add("1", [CAR, ROAD], None, sequence="07")
    outcome = compared(runs)
    assert [scan.name for scan in outcome.missing.scans] == ["07/1"]
    assert (outcome.comparison.missing, outcome.comparison.not_asked_for) == (("07/1",), 0)
    folder = runs[0].dataset / "sequences/07/velodyne"
    for world in runs:
        record(world)
        path = world.out / "predict.json"
        content = json.loads(path.read_text())
        content["scans"] = {"07": {"folder": str(folder), "asked_for": ["0.bin"]}}
        path.write_text(json.dumps(content))
    outcome = compared(runs)
    assert (outcome.missing.scans, outcome.missing.not_asked_for) == ((), 1)


def test_a_short_drive_has_no_interval(runs):
    before, after = runs
    for number in range(SCANS):
        before.add(f"{number}", [CAR, ROAD], [CAR, CAR], sequence="09")
        after.add(f"{number}", None, [CAR, ROAD], sequence="09")
    found = compared(runs, selection=ScanSelection(sequences=("09",))).comparison
    assert (found.scored, found.parts, found.accuracy.change) == (SCANS, 1, 0.5)
    assert (found.accuracy.low, found.accuracy.is_clear) == (None, False)
    assert "no intervals" in printed(found)


def test_other_scans_of_the_same_names_are_refused(runs, tmp_path):
    moved = tmp_path / "moved"
    shutil.copytree(runs[0].dataset, moved)
    for world, dataset in zip(runs, (runs[0].dataset, moved), strict=True):
        record(world)
        content = json.loads((world.out / "predict.json").read_text())
        content["scans"] = {
            sequence.name: {"folder": str(sequence / "velodyne"), "asked_for": ["0.bin"]}
            for sequence in (dataset / "sequences").iterdir()
        }
        (world.out / "predict.json").write_text(json.dumps(content))
    assert compare(runs[0].out, runs[1].out).comparison.scans == SCANS
    first = moved / "sequences/00/velodyne/0.bin"
    first.write_bytes(np.flip(np.fromfile(first, np.float32)).tobytes())
    with refused(UsageError, first):
        compare(runs[0].out, runs[1].out)


def test_labels_of_other_lengths_fail_alone(runs):
    runs[1].add("0", None, [CAR] * 3, sequence="01")
    outcome = compared(runs)
    assert [failure.code for failure in outcome.failures] == ["label"]
    assert outcome.comparison.scans == SCANS - 1


@pytest.mark.drawn
@pytest.mark.parametrize("with_truth", [True, False])
def test_the_most_changed_scan_is_drawn_by_what_changed(runs, with_truth):
    """The truth of the points 0 to 5: road, road, car, car, road and none; 6 has another id."""
    truth = [ROAD, ROAD, CAR, CAR, ROAD, 0, UNKNOWN]
    before = [ROAD, CAR, CAR, TREE, CAR, CAR, CAR]
    after = [ROAD, ROAD, ROAD, ROAD, TREE, ROAD, ROAD]
    kinds = ["same label", "now right", "now wrong", *4 * ["other label"]]
    runs[0].add("0", truth, before, sequence="05")
    runs[1].add("0", None, after, sequence="05")
    if not with_truth:
        without_truth(runs)
        kinds = ["same label", *6 * ["other label"]]
    with calls_of(scan_picture) as calls:
        compared(runs)
    views = calls[0]["views"]
    assert [*views] == ["first run", "second run", *["truth"] * with_truth, "changes"]
    assert [tuple(colour) for colour in views["changes"]] == [CHANGES[kind] for kind in kinds]
    colours = screen_colours(SPACE)
    for title, raw in (("first run", before), ("second run", after)):
        train = SPACE.to_train(np.array(raw, np.uint32))
        np.testing.assert_array_equal(views[title], colours[train])
    assert imread(runs[1].out / FILES[2]).shape[1] > 1800


def test_the_page_of_a_run_has_the_changes(runs):
    for world in runs:
        record(world)
    assert 'id="changes"' not in page(runs)
    compared(runs)
    text = page(runs)
    assert 'id="changes"' in text
    assert "clearly better" in text
    assert "car became road" in text
    assert "scores judged at once" in text
    assert f'alt="{SCORES[FILES[1]]}"' in text
    record(runs[1], temperature=2.0)
    assert 'id="changes"' not in page(runs)


@pytest.mark.parametrize("command", ["compare", "eval", "report"])
def test_nodes_of_a_cluster_must_see_the_results_that_they_read(runs, monkeypatch, command):
    asked = []

    def attempts_of_nodes(task, scans, options, folders):
        asked.append(folders)
        yield from attempts_in_process(task, scans, RunOptions())

    monkeypatch.setattr(attempts, "attempts_of_cluster", attempts_of_nodes)
    before, after = runs
    options = RunOptions(cluster="auto")
    query = ResultQuery(before.dataset)
    reads = (after.out,)
    if command == "compare":
        compare(before.out, after.out, query=query, options=options)
        reads = (before.out, after.out)
    elif command == "eval":
        evaluate(after.out, query=query, options=options)
    else:
        report(after.out, query=query, options=options)
    assert asked == [RunFolders(reads=reads)]


def page(runs):
    made = report(runs[1].out, query=ResultQuery(runs[0].dataset))
    return made.page.read_text("utf-8")
