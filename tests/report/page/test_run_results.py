# SPDX-License-Identifier: MIT
"""Results of a run for its page: rows, facts, clouds."""

import base64
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evaluated import run_of, small_space
from hypothesis import example, given
from hypothesis import strategies as st
from scans import SMALL, make_scan, refused

from salsanext_cli import Scan, label_space, project
from salsanext_cli.core.errors import FormatError, UsageError
from salsanext_cli.core.geometry.objects import BOX
from salsanext_cli.core.measures.counts import ScanCounts
from salsanext_cli.core.measures.expected_accuracy import ExpectedAccuracy
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.weights.card_file import default_weights, read_card
from salsanext_cli.report.page.clouds import NO_VALUE, encode_cloud, scales_of
from salsanext_cli.report.page.drive_data import drive_data
from salsanext_cli.report.page.recorded_warnings import codes_by_scan, warnings_of_run
from salsanext_cli.report.page.run_results import RunResults, ShownScan, read_boxes
from salsanext_cli.report.page.scan_row import PointErrors, ScanRow
from salsanext_cli.runs.results.manifest import Manifest, StageRecord
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.paths import ScanFile
from salsanext_cli.runs.results.result_folder import ScanResults

SPACE = small_space("unlabeled", "car", "road")


def row(stem, confusion=None, sequence="00", **uncertainty):
    file = ScanFile(sequence, stem, Path(f"/{stem}.bin"))
    matrix = np.zeros((3, 3), int) if confusion is None else np.array(confusion)
    return ScanRow(file, 10, np.array([0, 5, 5]), uncertainty, matrix)


def test_wrong_points_are_judged_ones_and_the_error_leads_before_the_entropy():
    assert row("a", [[0, 0, 0], [1, 3, 0], [0, 2, 4]]).wrong == pytest.approx(3 / 10)
    assert math.isnan(row("a").wrong)
    assert math.isnan(row("a", np.zeros((3, 3), int)).wrong)
    rows = [row("1", entropy=1.0), row("2", error=0.5)]
    assert run_of(rows=rows).leading_kind == "error"
    assert run_of(rows=rows[:1]).leading_kind == "entropy"
    assert run_of(rows=[row("3")]).leading_kind is None


def test_most_uncertain_most_wrong_and_worst_class_are_chosen():
    rows = [
        row("0", [[0, 0, 0], [0, 9, 1], [0, 0, 90]], entropy=0.1),
        row("1", [[0, 0, 0], [0, 9, 1], [0, 0, 90]], entropy=0.9),
        row("2", [[0, 0, 0], [0, 0, 0], [0, 0, 10]], entropy=math.nan),
        row("3", [[0, 0, 0], [0, 1, 4], [0, 0, 95]], entropy=0.2),
        row("4", [[0, 0, 0], [0, 5, 0], [0, 3, 2]], entropy=0.2),
    ]
    run = run_of(rows=rows, space=SPACE)
    chosen = run.notable_scans()
    assert chosen["00/1"] == "most uncertain (mean entropy 0.9)"
    assert chosen["00/4"] == "most wrong (30.0 % of the labelled points)"
    assert chosen["00/3"] == "worst class: 4 points of car wrong"
    assert sorted(chosen.values())[0] == "at random"
    assert len(chosen) == 4
    assert chosen == run.notable_scans()
    rejecting = replace(run, reader=replace(run.reader, rejects=True))
    wrong = rejecting.notable_scans()["00/4"]
    assert wrong == "most wrong (30.0 % of the accepted points with a true class)"


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("error", "mean probability of error 18.6 %"),
        ("least_confidence", "mean 1 − confidence 18.6 %"),
        ("disagreement", "mean disagreement 18.6 %"),
        ("entropy", "mean entropy 0.186"),
        ("mutual_information", "mean mutual information 0.186"),
    ],
)
def test_a_mean_uncertainty_has_one_title_and_shares_are_percentages(kind, words):
    run = run_of(rows=[row("1", **{kind: 0.1862})], space=SPACE)
    assert run.leading_kind == kind
    assert run.notable_scans()["00/1"] == f"most uncertain ({words})"
    numbers = drive_data(run, np.ones((1, 3), int), ["00/1"], {})
    assert numbers["is_share"] == words.endswith("%")


def test_scans_are_named_by_sequence_and_stem_or_by_the_stem_alone():
    rows = [row("1", sequence="00"), row("1", sequence="08"), row("2", sequence="08")]
    run = run_of(rows=rows)
    assert run.scans_by_name(["2", "00/1"]) == {"08/2": "named", "00/1": "named"}
    for name in ("1", "08/9"):
        with pytest.raises(UsageError) as caught:
            run.scans_by_name([name])
        assert (caught.value.subject, caught.value.code) == ("scans", "usage")


def record(out, stage, folders, **settings):
    shared = {"label_space": label_space().to_dict(), "sensor": SMALL.to_dict()}
    Manifest(out).write(StageRecord(stage, shared | settings, folders))


def test_the_default_weights_are_described(tmp_path):
    record(
        *(tmp_path, "predict", ("predictions",)),
        **{"weights": fingerprint(default_weights()), "engine": "openvino"},
        **{"precision": "bfloat16", "temperature": 1.25, "reject": 0.3},
    )
    facts = dict(run_of(tmp_path).facts())
    start = read_card(default_weights()).description.replace("`", "").partition(" See ")[0]
    assert start in facts["Weights"]
    # A mailed page has no links to the documentation.
    assert ".md" not in facts["Weights"]
    assert "Not for use on real roads." in facts["Weights"]
    assert facts["Sensor"].startswith("small, 16×128, field of view +3° to -25°")
    assert "openvino in bfloat16, temperature 1.25" in facts["Labels"]
    assert facts["Labels"].endswith("rejected: error above 0.3")
    assert "Uncertainty" not in facts


def test_other_weights_are_named_by_their_digest_if_it_is_recorded(tmp_path):
    assert dict(run_of(tmp_path).facts())["Weights"] == "not recorded"
    record(
        *(tmp_path, "uncertainty", ("uncertainty/epistemic",)),
        **{"weights": "ab" * 32, "method": "sampling", "samples": 30, "aleatoric": "copies"},
    )
    facts = dict(run_of(tmp_path).facts())
    assert facts["Weights"].startswith("SHA-256 abababababab, not the default weights")
    assert facts["Uncertainty"] == "sampling, samples 30, aleatoric copies"


def test_warnings_of_all_stages_are_one_line_for_each_code(tmp_path):
    dark, few = ("dark", "no intensity", "look"), ("few-points", "12 points", "drive on")
    warnings = {f"00/{i}": [dark] for i in range(5)}
    OwnedFolder(tmp_path, "predict").record_findings(warnings, set(warnings))
    OwnedFolder(tmp_path, "uncertainty").record_findings({"00/1": [dark, few]}, {"00/1"})
    assert warnings_of_run(tmp_path, warnings) == [
        "dark in 5 scans (00/0, 00/1, 00/2 and 2 more): no intensity; look",
        "few-points in 1 scan (00/1): 12 points; drive on",
    ]
    assert warnings_of_run(tmp_path, {"00/3"}) == ["dark in 1 scan (00/3): no intensity; look"]
    assert warnings_of_run(tmp_path / "none", warnings) == []
    OwnedFolder(tmp_path, "fuse").record_findings({"00": [("apart", "two parts", "look")]}, {"00"})
    assert warnings_of_run(tmp_path, {"00"}) == ["apart in 1 sequence (00): two parts; look"]


@pytest.mark.parametrize(
    ("trained_on", "estimate", "measured"),
    [(0, None, 0.7), (0, 0.5, 0.7), (1, 0.5, None), (1, 0.8, 0.7), (1, None, None)],
)
def test_scores_of_training_scans_count_only_against_the_labels(
    monkeypatch, trained_on, estimate, measured
):
    expected = None if estimate is None else ExpectedAccuracy(estimate, (0.0, 1.0), 1, {})
    monkeypatch.setattr(RunResults, "expected_accuracy", lambda _: expected)
    confusion = np.array([[0, 0, 0], [0, 3, 2], [0, 1, 4]])
    counts = ScanCounts(confusion, scans=1, trained_on=trained_on)
    run = replace(run_of(rows=[row("1")], space=SPACE), counts=counts)
    assert run.evidence().measured == measured
    rejecting = replace(counts, accepted={"00/1": (12, 10, 3)})
    assert replace(run, counts=rejecting).evidence().measured is None


def test_a_warning_about_a_sequence_counts_for_each_of_its_scans(tmp_path):
    files = [ScanFile(sequence, "1", Path("/1.bin")) for sequence in ("00", "08")]
    OwnedFolder(tmp_path, "fuse").record_findings({"00": [("apart", "two parts", "look")]}, {"00"})
    few = ("few-points", "12 points", "drive on")
    OwnedFolder(tmp_path, "predict").record_findings({"00/1": [few]}, {"00/1"})
    assert codes_by_scan(tmp_path, files) == {"00/1": ["apart", "few-points"], "08/1": []}


@given(st.lists(st.floats(0, 1, width=32) | st.just(math.nan), max_size=20))
def test_errors_are_counted_over_the_points_that_have_one(values):
    errors = PointErrors.of_values(np.array(values, np.float32))
    known = [value for value in values if not math.isnan(value)]
    assert errors.points == len(known)
    assert errors.total == pytest.approx(sum(known), abs=1e-5)
    assert errors.doubtful == sum(value > np.float32(0.1) for value in known)
    assert (errors + errors).points == 2 * len(known)
    if known:
        assert (errors + errors).doubtful_share == errors.doubtful_share
        assert errors.mean == pytest.approx(sum(known) / len(known), abs=1e-5)
    else:
        assert (errors.mean, errors.doubtful_share) == (None, None)


def test_boxes_are_read_from_the_table_or_it_is_refused(tmp_path):
    path, space = tmp_path / "000000.csv", label_space()
    assert read_boxes(path, space) == []
    head = f"object,class,points,{','.join(BOX)}\n"
    path.write_text(f"{head}1,car,12,1,2,3,4,2,1.5,-0.5\n2,merged,9,0,0,0,1,1,1,0\n")
    car = space.names.index("car")
    assert read_boxes(path, space) == [[car, 1, 2, 3, 4, 2, 1.5, -0.5], [0, 0, 0, 0, 1, 1, 1, 0]]
    for damaged in ("1,car,12,1,2,3,4,2,1.5,nan", "1,car,12,1,2", "1,car,12,1,2,3,4,2,1.5,wide"):
        path.write_text(head + damaged)
        refused(FormatError, path, read_boxes, path, space)


SEMANTIC_KITTI = label_space()


def shown(scan, **known):
    return ShownScan("08/000000", "named", ScanResults(scan, **known))


def numbers(text, dtype):
    return np.frombuffer(base64.b64decode(text), dtype)


def encoded(one):
    return encode_cloud(one, SEMANTIC_KITTI, SMALL, scales_of([one]))


def of_pixel(data):
    return numbers(data["of_pixel"], f"<u{data['of_pixel_bytes']}")


def in_order_of_pixels(scan):
    """Sort points by pixel, the nearest of each first, by a slow clear loop."""
    image = project(scan, SMALL)
    of_pixel = {}
    for point, pixel in enumerate(image.pixel_of_point.tolist()):
        of_pixel.setdefault(pixel if pixel >= 0 else SMALL.height * SMALL.width, []).append(point)
    order, counts = [], np.zeros(SMALL.height * SMALL.width + 1, int)
    for pixel, points in sorted(of_pixel.items()):
        order += sorted(points, key=lambda point: image.point_range[point])
        counts[pixel] = len(points)
    return order, counts[:-1]


@example(0, 0)
@example(0, 1)
@given(st.integers(0, 10_000), st.integers(0, 400))
def test_positions_and_pixels_come_back(seed, count):
    scan = make_scan(count, seed)
    data = encoded(shown(scan))
    order, counts = in_order_of_pixels(scan)
    assert data["shown"] == data["points"] == count
    assert np.isfinite([*data["low"], *data["step"]]).all()
    assert np.array_equal(of_pixel(data), counts)
    steps = numbers(data["position"], "<u2").reshape(-1, 3)
    positions = np.array(data["low"]) + np.array(data["step"]) * steps
    assert np.abs(positions - scan.points[order]).max(initial=0) <= max(data["step"])


def test_values_come_back_on_their_scale_and_none_stays_none():
    scan = make_scan(300)
    order, _ = in_order_of_pixels(scan)
    entropy = np.linspace(0, 2, 300, dtype=np.float32)
    entropy[7] = np.nan
    error = np.linspace(0, 1, 300, dtype=np.float32)
    kinds = {"entropy": entropy, "error": error, "least_confidence": error / 2}
    one = shown(scan, uncertainty=kinds)
    scales = scales_of([one])
    assert scales["least_confidence"] == {"marks": (0, 1), "unit": ""}
    assert 1.9 < scales["entropy"]["marks"][1] <= 2
    values = encoded(one)["values"]
    assert [*values] == ["error", "entropy", "least_confidence", "range", "intensity"]
    for name, exact in kinds.items():
        steps, marks = numbers(values[name], "u1"), scales[name]["marks"]
        wanted = np.minimum(exact[order], marks[-1])
        known = ~np.isnan(wanted)
        assert np.array_equal(steps == NO_VALUE, ~known)
        back = np.interp(steps[known], np.linspace(0, 254, len(marks)), marks)
        # Steps of the error are finer where it is small.
        step = np.where(wanted[known] < 0.02, marks[1], marks[-1] - marks[-2])
        assert (np.abs(back - wanted[known]) <= 0.5 * step * (len(marks) - 1) / 254 + 1e-6).all()


def test_classes_are_train_ids_wrong_points_two_and_unmeasured_ones_skipped():
    scan = Scan(np.array([[1, 0, 0], [2, 1, 0], [3, -1, 0]], np.float32), np.zeros(3, np.float32))
    raw = np.array([10, 40, 10], np.uint32), np.array([10, 10, 0], np.uint32)
    one = shown(scan, label=raw[0], truth=raw[1])
    order, _ = in_order_of_pixels(scan)
    values = {name: numbers(text, "u1") for name, text in encoded(one)["values"].items()}
    assert values["label"].tolist() == np.array([1, 9, 1])[order].tolist()
    assert values["truth"].tolist() == np.array([1, 1, 0])[order].tolist()
    assert values["wrong"].tolist() == np.array([1, 2, 0])[order].tolist()
    scan = make_scan(50)
    points = scan.points.copy()
    points[3], points[4], points[5, 0] = np.nan, np.inf, 1e8
    data = encoded(shown(replace(scan, points=points)))
    assert (data["points"], data["shown"]) == (50, 47)
    assert max(data["step"]) < 0.01


@pytest.mark.parametrize(("count", "size"), [(255, 1), (256, 2), (70_000, 4)])
def test_many_points_of_one_pixel_are_counted(count, size):
    points = np.tile(np.array([[5, 0, 0]], np.float32), (count, 1))
    data = encoded(shown(Scan(points, np.zeros(count, np.float32))))
    assert data["of_pixel_bytes"] == size
    assert of_pixel(data).max() == count
