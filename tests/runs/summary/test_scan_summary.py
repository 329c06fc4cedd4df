# SPDX-License-Identifier: MIT
"""Summary of a run: classes, warnings, scans of two sensors, bands."""

from collections import Counter
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from calls import calls_of
from evaluation_runs import small_space
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL

from salsanext_cli import Scan, label_space
from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.checks.label_checks import LABELS_HINT
from salsanext_cli.core.checks.scan_checks import ScanCheck, check_scan
from salsanext_cli.core.geometry.scan_traits import groups_of
from salsanext_cli.core.measures.counts import ScanCounts
from salsanext_cli.core.measures.population import population_difference, unit_traits
from salsanext_cli.core.network.card import AccuracyLine, RiskThreshold
from salsanext_cli.core.network.unit_traits import UnitTraits
from salsanext_cli.runs.fit.mixed_sensors import mixed_sensors
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.summary import threshold_scans
from salsanext_cli.runs.summary.run_findings import RunFindings
from salsanext_cli.runs.summary.run_summary import RunSummary
from salsanext_cli.runs.summary.scan_summary import ScanSummary

SPACE = label_space()
FILE = ScanFile(sequence="08", stem="000000", path=Path("000000.bin"))
SCANS = st.lists(st.lists(st.integers(0, SPACE.class_count - 1), max_size=30), max_size=5)


@given(SCANS)
def test_the_largest_classes_are_those_counted_slowly(scans):
    summary = RunSummary(sensor=SMALL, space=SPACE)
    for train_ids in scans:
        labels = np.array(train_ids, np.uint8)
        summary.add(ScanSummary.from_labels(FILE, labels, SPACE))
    counts = Counter(SPACE.names[i] for train_ids in scans for i in train_ids)
    largest = summary.counts.largest_classes(summary.space)
    assert all(share == counts[name] / counts.total() for name, share in largest.items())
    total, unlabelled = counts.total(), counts.pop(SPACE.names[0], 0)
    assert list(largest.values()) == [count / total for _, count in counts.most_common(5)]
    assert summary.counts.unlabelled_share == unlabelled / max(total, 1)


def codes_of(labels, space=SPACE, **options):
    summary = ScanSummary.from_labels(FILE, labels, space, **options)
    return [finding.code for finding in summary.check.findings]


def test_labels_of_low_probability_are_doubted():
    labels = np.arange(1000, dtype=np.uint8) % 20
    assert codes_of(labels, confidence=0.5) == ["low-confidence"]
    assert codes_of(labels, confidence=0.6) == []
    few = small_space(*map(str, range(8)))
    assert codes_of(labels % 8, few, confidence=0.72) == ["low-confidence"]
    assert codes_of(labels % 8, few, confidence=0.76) == []


def test_hints_about_labels_name_the_folder_of_the_run(caplog):
    finding = Finding("one-class", "80 % of the points are road", LABELS_HINT)
    for out, hint in (
        (None, LABELS_HINT),
        (Path("my out"), f"{LABELS_HINT}: `salsanext report 'my out'`"),
    ):
        summary = RunSummary(sensor=SMALL, space=SPACE, findings=RunFindings(out=out))
        summary.findings.add(FILE.name, finding)
        assert [warning.hint for warning in summary.warnings()] == [hint]
        assert caplog.messages[-1].endswith(f"hint: {hint}")
        # The folder may be moved, so it is not recorded.
        assert summary.findings.by_code["one-class"] == [(FILE.name, finding)]


def test_rejected_labels_do_not_make_one_class_large():
    # Two classes have equal numbers of points; the labels of one of them are rejected.
    labels = np.repeat(np.array([1, 9], np.uint8), 1000)
    summary = ScanSummary.from_labels(FILE, labels, SPACE)
    rejected = labels == 9
    uncertainty = rejected.astype(np.float32)
    traits = unit_traits(FILE.name, summary.class_points, uncertainty)
    rest = replace(summary, traits=traits).without_rejected(rejected, labels, uncertainty)
    assert rest.traits.uncertainty == 0.5
    assert sorted(rest.traits.class_shares)[-2:] == [0.5, 0.5]
    assert rest.check.findings == ()
    assert (rest.class_points[0], rest.class_points[1], rest.class_points[9]) == (1000, 1000, 0)
    assert rest.rejected_points == 1000
    assert summary.class_points[9] == 1000, "the summary of all labels stays as it was"
    only_cars = ScanSummary.from_labels(FILE, labels[:1000], SPACE)
    assert [finding.code for finding in only_cars.check.findings] == ["one-class"]


@pytest.mark.parametrize(
    ("count", "share", "codes"),
    [
        *((20, 0.72, []), (20, 0.78, ["one-class"]), (8, 0.83, []), (8, 0.87, ["one-class"])),
        (3, 1, []),
    ],
)
def test_a_class_of_nearly_the_whole_scan_is_doubted(count, share, codes):
    labels = np.where(np.arange(1000) < 1000 * share, 1, 2).astype(np.uint8)
    space = small_space(*map(str, range(count)))
    assert codes_of(np.append(labels, np.zeros(5000, np.uint8)), space) == codes
    assert codes_of(labels[:50], space) == []


@given(st.permutations(range(6)))
def test_warnings_do_not_depend_on_the_order_of_the_scans(order):
    scans = []
    for number in range(6):
        codes = ("tilted", "height", "of-3")[: number % 3]
        findings = tuple(Finding(code, f"{code} of {number}", "turn it") for code in codes)
        file = ScanFile(sequence="08", stem=f"{number}", path=Path("scan.bin"))
        scans.append(ScanSummary(file=file, check=ScanCheck(findings=findings)))
    summary = RunSummary(sensor=SMALL)
    for place in order:
        summary.add(scans[place])
    height, tilted = summary.warnings()
    assert (height.message, height.scans) == ("height of 2", ["08/2", "08/5"])
    assert (tilted.message, tilted.scans) == ("tilted of 1", ["08/1", "08/2", "08/4", "08/5"])


BEAMS = {
    "of-16": (np.linspace(15, -15, 16), 450),
    "of-32": (np.linspace(10.67, -30.67, 32), 272),
    "of-64": (np.linspace(2, -24.9, 64), 512),
    "dense": (np.concatenate([np.linspace(15, -6, 52), np.linspace(-7, -25, 12)]), 450),
    "wide": (np.linspace(45, -45, 128), 256),
    "half-wide": (np.linspace(22.5, -22.5, 128), 256),
}
"""Elevations of beams in degrees, and a quarter of the columns, as rotating sensors have them."""


def scan_of(name, place, brightest=0.5):
    """Return a scan at one of many places: open or narrow, with sky above, on a car or a robot."""
    beams, columns = BEAMS[name]
    random = np.random.default_rng((place, len(beams)))
    elevation, azimuth = np.meshgrid(np.radians(beams), np.linspace(-np.pi, np.pi, columns))
    elevation = elevation + np.radians(random.normal(0, 0.02, elevation.shape))
    walls = random.uniform(6, 60) * (1.5 + np.sin(random.integers(1, 4) * azimuth))
    wall, tall = walls / np.cos(elevation), walls * np.tan(elevation) < random.uniform(1, 15)
    height = random.uniform(1.5, 2.1)
    ground = -height / np.minimum(np.sin(elevation), -1e-3)
    distance = np.where(tall, np.minimum(wall, ground), ground)
    hit = (distance < 100) & (random.random(distance.shape) < random.uniform(0.9, 1))
    flat = distance * np.cos(elevation)
    xyz = (flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation))
    points = np.stack(xyz, axis=-1)[hit].astype(np.float32)
    bright = np.linspace(0, brightest * random.uniform(0.7, 1.4), len(points))
    return Scan(points, bright.astype(np.float32))


def traits(scan, of=SMALL):
    return check_scan(FILE.path, scan, of).traits


def files(sequence, count):
    return [
        ScanFile(sequence=sequence, stem=f"{number:06d}", path=FILE.path) for number in range(count)
    ]


def mixed(*traits_of_scans):
    return mixed_sensors(dict(zip(files("08", len(traits_of_scans)), traits_of_scans, strict=True)))


@cache
def places_of(name):
    """Return the traits of scans of one sensor at nine places."""
    return [traits(scan_of(name, place)) for place in range(9)]


@pytest.mark.parametrize("name", BEAMS)
def test_scans_of_one_sensor_at_different_locations_are_not_mixed(name):
    for scans in (places_of(name), *combinations(places_of(name), 2)):
        assert mixed(*scans) == {}


@pytest.mark.parametrize(("one", "other"), [*combinations(BEAMS, 2)])
@pytest.mark.parametrize(("of_one", "of_other"), [(6, 6), (9, 1), (1, 9)])
def test_scans_of_two_sensors_are_mixed(one, other, of_one, of_other):
    scans = dict(zip(files("00", of_one), places_of(one), strict=False))
    scans |= dict(zip(files("08", of_other), places_of(other), strict=False))
    findings = mixed_sensors(scans)
    fewer = "00" if of_one < of_other else "08"
    assert {file for file in scans if file.sequence == fewer} == findings.keys()
    assert {finding.code for finding in findings.values()} == {"mixed-sensors"}


def cut(scan, share):
    """Return a scan of which only a part of a turn was written."""
    turn = np.arctan2(scan.points[:, 1], scan.points[:, 0]) / (2 * np.pi) + 0.5
    return scan.take(np.flatnonzero(turn < share))


def thinned(scan, share):
    """Return a scan of which some points are missing everywhere."""
    return scan.take(np.flatnonzero(np.random.default_rng(0).random(len(scan)) < share))


@pytest.mark.parametrize("part", [cut, thinned])
@pytest.mark.parametrize("share", [0.4, 0.6])
def test_a_truncated_or_thinned_scan_is_of_the_same_sensor(part, share):
    for name in BEAMS:
        scan = scan_of(name, 0)
        assert mixed(traits(scan), traits(part(scan, share))) == {}


def test_small_scans_of_two_sensors_are_mixed_and_different_fits_not_compared():
    small, other = (traits(thinned(scan_of(n, 0), 0.2)) for n in ("of-16", "wide"))
    large = traits(scan_of("dense", 0))
    assert len(mixed(large, small, other)) == 2
    assert len({*groups_of([large, small, other])}) == 3
    assert (
        mixed(places_of("of-16")[0], traits(scan_of("of-64", 0), replace(SMALL, fov_up=20.0))) == {}
    )


def test_intensities_of_two_scales_are_mixed_but_not_those_of_a_wet_road():
    usual, in_bytes, none = (replace(places_of("of-64")[0], bright=b) for b in (0.5, 130.0, 0.0))
    ((file, finding),) = mixed(usual, usual, in_bytes, none).items()
    assert file.stem == "000002"
    assert "130)" in finding.problem
    # The factor is the largest of one real sensor; scales differ by 100 or more.
    dry, wet = (replace(places_of("of-64")[0], bright=bright) for bright in (0.247, 0.043))
    assert groups_of([dry, wet]) == [0, 0]


def test_a_finished_run_warns_of_mixed_sensors(caplog):
    summary = RunSummary(sensor=SMALL)
    for file, of_scan in zip(
        files("08", 5), [*places_of("of-64")[:4], places_of("of-16")[0]], strict=True
    ):
        summary.add(ScanSummary(file=file, check=ScanCheck(findings=(), traits=of_scan)))
    assert not caplog.messages
    (warning,) = summary.finished().warnings()
    assert (warning.code, warning.scans) == ("mixed-sensors", ["08/000004"])
    assert "such as 08/000000" in caplog.text


@pytest.mark.parametrize(
    ("right", "wrong", "share"), [(300, 9800, "3.0 %"), (2100, 8000, ""), (1, 900, "")]
)
def test_labels_that_hardly_agree_with_predictions_are_doubted(right, wrong, share):
    counts = ScanCounts.none(SPACE, by_distance=False)
    counts.confusion[[1, 9, 0], [1, 0, 5]] = right, wrong, 100_000
    warnings = [*counts.label_warnings(SPACE)]
    assert len(warnings) == bool(share)
    assert all(share in text and "label_space" in text for text in warnings)


def test_the_share_of_the_vehicle_is_one_of_points():
    summary = RunSummary(sensor=SMALL, space=SPACE)
    for name, count, ego in (("a", 900, 0), ("b", 100, 50)):
        labels = np.ones(count, np.uint8)
        check = ScanCheck(points=count, ego_points=ego)
        summary.add(ScanSummary.from_labels(replace(FILE, stem=name), labels, SPACE, check))
    assert summary.counts.ego_share == pytest.approx(0.05)


@pytest.mark.parametrize("most", [3, 5])
def test_the_order_of_workers_does_not_change_the_comparison_with_a_threshold(monkeypatch, most):
    monkeypatch.setattr(threshold_scans, "MAX_COMPARED", most)
    traits = {
        f"08/{i:06}": UnitTraits(unit=str(i), uncertainty=i / 10, class_shares=()) for i in range(5)
    }
    population = tuple(traits.values())
    risk = RiskThreshold("error", 0.2, 0.1, None, 12, ("00",), population=population)
    with calls_of(population_difference) as comparisons:
        for names in (list(traits), list(traits)[::-1]):
            summary = RunSummary(sensor=SMALL, space=SPACE, threshold=risk)
            for name in names:
                summary.population.add(name, traits[name])
            summary.names = set(names)
            summary.compare_scans()
    first, second = (call["now"] for call in comparisons)
    assert first == second
    assert len(first) == most
    assert {*first} <= {*traits.values()}


def test_findings_of_two_steps_are_those_of_both():
    predicted = RunSummary(sensor=SMALL, space=SPACE, accuracy=AccuracyLine(1.0, 0.0, 0.05))
    fused = RunSummary(sensor=SMALL, space=SPACE)
    for summary, stems in ((predicted, "ab"), (fused, "bc")):
        for stem in "abcd":
            codes = ("one-class",) if stem in stems else ()
            findings = tuple(Finding(code, f"{stem}", LABELS_HINT) for code in codes)
            file = replace(FILE, stem=stem)
            check = ScanCheck(findings=findings)
            summary.add(ScanSummary(file=file, check=check, confidence=0.8))
    fused.add_sequence("08", [Finding("apart", "2 parts", LABELS_HINT)])
    predicted.findings.add_others(fused.findings)
    apart, one_class = predicted.warnings()
    assert (apart.code, apart.scans) == ("apart", ["08"])
    assert one_class.scans == ["08/a", "08/b", "08/c"]
    estimate = predicted.expected_accuracy()
    assert (estimate.scans, estimate.withheld) == (1, {"one-class": 3})
    assert [len(findings) for findings in fused.findings.by_code.values()] == [2, 1]
