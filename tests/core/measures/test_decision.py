# SPDX-License-Identifier: MIT
"""Decision about the labels of a run: its limits, and the warnings that decide."""

import shlex
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.commands.line.options.option_names import CommandLine
from salsanext_cli.core.measures.decision import CODES, LEVELS, Decision, Evidence, verdict
from salsanext_cli.core.measures.expected_accuracy import OF_RUN, WITHHELD_FOR, ExpectedAccuracy
from salsanext_cli.core.wording import setting, spelled

FINE = Evidence(scans=10, class_count=20)
ORDER = [level.decision for level in LEVELS]
SHARES = st.none() | st.floats(0, 1)


def names(count: int, first: int = 0) -> list[str]:
    """Return names of scans."""
    return [f"00/{number:06}" for number in range(first, first + count)]


def estimate(accuracy: float) -> ExpectedAccuracy:
    return ExpectedAccuracy(
        accuracy=accuracy,
        interval=(max(accuracy - 0.1, 0), min(accuracy + 0.1, 1)),
        scans=10,
        withheld={},
    )


@pytest.mark.parametrize(
    ("accuracy", "doubtful", "decision"),
    [
        (0.85, 0.4, Decision.USE),
        (0.85, 0.41, Decision.COARSE),
        (0.84, 0.1, Decision.COARSE),
        (0.75, 0.65, Decision.COARSE),
        (0.74, 0.65, Decision.LABEL_TEN),
        (0.95, 0.7, Decision.LABEL_TEN),
        (0.6, 0.85, Decision.LABEL_TEN),
        (0.59, 0.1, Decision.LABEL_FORTY),
        (0.9, 0.86, Decision.LABEL_FORTY),
        # The ten scans of the tutorial, and two of the least certain drives of SemanticKITTI
        (0.871, 0.376, Decision.USE),
        (0.804, 0.548, Decision.COARSE),
        (0.785, 0.605, Decision.COARSE),
        (None, 0.2, Decision.LABEL_TEN),
        (0.8, None, Decision.COARSE),
    ],
)
def test_the_worse_of_accuracy_and_doubtful_points_decides(accuracy, doubtful, decision):
    measured = replace(FINE, measured=accuracy, doubtful=doubtful)
    assert verdict(measured).decision is decision
    expected = estimate(accuracy) if accuracy is not None else None
    assert verdict(replace(FINE, expected=expected, doubtful=doubtful)).decision is decision


@given(SHARES, SHARES, st.integers(2, 30))
def test_worse_numbers_never_lead_to_a_better_decision(accuracy, doubtful, classes):
    evidence = Evidence(scans=10, class_count=classes, measured=accuracy, doubtful=doubtful)
    result = verdict(evidence)
    if accuracy is None and doubtful is None:
        assert result is None
        return
    worse = replace(
        evidence, measured=accuracy and accuracy / 2, doubtful=doubtful and (1 + doubtful) / 2
    )
    assert ORDER.index(verdict(worse).decision) >= ORDER.index(result.decision)


def test_the_reason_of_one_scan_counts_no_scans():
    one = replace(FINE, scans=1, measured=0.95)
    assert verdict(replace(one, warned={"height": names(1)})).reason.endswith(
        "the scan has the warning height"
    )
    both = verdict(replace(one, warned={"height": names(1), "sparse": names(1)})).reason
    assert both.endswith("the scan has the warnings height and sparse")
    several = verdict(replace(one, scans=3, warned={"height": names(2)})).reason
    assert several.endswith("of 3 scans, 2 with height")


def test_coarse_classes_are_not_advised_for_coarse_labels():
    coarse = replace(FINE, class_count=8, measured=0.8)
    assert verdict(coarse).decision is Decision.LABEL_TEN
    assert verdict(replace(coarse, measured=0.9)).decision is Decision.USE


def test_the_measured_accuracy_replaces_the_estimate():
    evidence = replace(FINE, expected=estimate(0.9), measured=0.7)
    assert verdict(evidence).decision is Decision.LABEL_TEN
    assert "70.0 %" in verdict(evidence).reason


@pytest.mark.parametrize(("decision", "codes"), CODES.items())
def test_a_warning_decides_if_most_scans_have_it(decision, codes):
    for code in codes:
        good = replace(FINE, measured=0.95)
        assert verdict(replace(good, warned={code: names(6)})).decision is decision
        half = verdict(replace(good, warned={code: names(5)}))
        if code in OF_RUN:
            assert half.decision is decision
            continue
        assert half.decision is Decision.USE
        assert half.reason.endswith(f"this may not hold for 5 of 10 scans: 5 with {code}")


def test_scans_with_any_warning_are_counted_once():
    numbers = replace(
        FINE,
        expected=ExpectedAccuracy(accuracy=None, interval=None, scans=0, withheld={}),
        doubtful=0.2,
    )
    halves = {"noisy": names(5), "near-returns": names(5, first=5)}
    result = verdict(replace(numbers, warned=halves))
    assert result.decision is Decision.LABEL_TEN
    assert result.reason.endswith("of 10 scans, 5 with near-returns, 5 with noisy")
    same = {"noisy": names(5), "near-returns": names(5)}
    assert verdict(replace(FINE, measured=0.95, warned=same)).decision is Decision.USE


def test_a_graver_warning_counts_for_the_milder_decision():
    warned = {"noisy": names(2), "tilted": names(2, first=2), "indoor": names(2, first=4)}
    good = replace(FINE, measured=0.95)
    result = verdict(replace(good, warned=warned))
    assert result.decision is Decision.LABEL_TEN
    assert result.reason.endswith("of 10 scans, 2 with indoor, 2 with tilted, 2 with noisy")
    more = warned | {"tilted": names(4)}
    assert verdict(replace(good, warned=more)).decision is Decision.CORRECT


@pytest.mark.parametrize("doubtful", [None, 0.0, 0.2])
def test_labels_of_unknown_accuracy_are_never_used_as_they_are(doubtful):
    withheld = ExpectedAccuracy(
        accuracy=None, interval=None, scans=0, withheld={"mixed-sensors": 3}
    )
    result = verdict(replace(FINE, expected=withheld, doubtful=doubtful))
    assert result.decision is Decision.LABEL_TEN
    assert "the accuracy is unknown" in result.reason


def test_an_estimate_of_half_of_the_scans_names_both_halves():
    half = replace(estimate(0.95), scans=5, withheld={"units": 5})
    evidence = replace(FINE, expected=half, doubtful=0.2, warned={"units": names(5)})
    sentence = verdict(evidence).sentence
    assert "the estimated accuracy of 5 scans is 85 to 100 %" in sentence
    assert "5 of 10 scans: 5 with units" in sentence


def test_warnings_do_not_improve_a_decision():
    bad = replace(FINE, measured=0.3, warned={"sparse": names(10)})
    assert verdict(bad).decision is Decision.LABEL_FORTY
    both = replace(bad, warned={"sparse": names(10), "tilted": names(10), "indoor": names(10)})
    assert verdict(both).decision is Decision.UNSUITED


def test_every_code_that_withholds_the_estimate_leads_to_one_decision():
    codes = [code for group in CODES.values() for code in group]
    assert sorted(codes) == sorted(WITHHELD_FOR)
    for code in WITHHELD_FOR:
        assert verdict(replace(FINE, warned={code: names(10)})).decision is not Decision.USE


def test_the_sentence_has_the_numbers():
    evidence = replace(FINE, expected=estimate(0.8), doubtful=0.42, warned={"sparse": names(7)})
    sentence = verdict(evidence).sentence
    assert all(text in sentence for text in ("70 to 90 %", "42.0 %", "10 %", "7 with sparse"))
    command = verdict(evidence).command("my drive", [setting("weights", "mine.safetensors")])
    assert command == (
        "salsanext pick 'my drive' to-label/ with count=10 and weights=\"mine.safetensors\""
    )
    with spelled(CommandLine()):
        command = verdict(evidence).command("my drive", [setting("weights", "mine.safetensors")])
    assert shlex.split(command) == [
        *("salsanext", "pick", "my drive", "to-label/"),
        *("--count", "10", "--weights", "mine.safetensors"),
    ]
    assert verdict(replace(FINE, measured=0.95)).command("drive", []) == ""


@pytest.mark.parametrize("level", [level for level in LEVELS if level.most_doubtful < 1])
def test_a_number_just_beyond_a_limit_does_not_read_as_the_limit(level):
    beyond = replace(FINE, measured=level.least_accuracy, doubtful=level.most_doubtful + 0.002)
    assert verdict(beyond).decision is not level.decision
    assert (
        f"{100 * level.most_doubtful:.0f}.2 % of the points with a label" in verdict(beyond).reason
    )
    below = replace(FINE, measured=level.least_accuracy - 0.002, doubtful=level.most_doubtful)
    assert verdict(below).decision is not level.decision
    assert f"{100 * level.least_accuracy - 1:.0f}.8 % of" in verdict(below).reason
