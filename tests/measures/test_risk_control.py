# SPDX-License-Identifier: MIT
"""Promises of thresholds: against closed forms, and by simulation of many calibrations."""

import math
from dataclasses import replace

import numpy as np
import pytest

from salsanext_cli import label_space
from salsanext_cli.measures.risk_control import (
    ACCEPTS_NONE,
    AcceptedLabels,
    RiskBoundCheck,
    allowed_scans,
    binomial,
    enough_drives,
    held_thresholds,
    means_of_units,
    needed_scans,
    promise,
)
from salsanext_cli.measures.scores import confusion_matrix
from salsanext_cli.network.card import RiskThreshold

DRAWS = 2000


@pytest.fixture(scope="module")
def streets():
    """Losses of 4,000 scans at 200 rising thresholds; some scans are much harder than others."""
    random = np.random.default_rng(0)
    hardness, shape = random.beta(1, 4, (4000, 1)), random.uniform(1, 4, (4000, 1))
    return hardness * np.linspace(0, 1, 200) ** shape


def calibrated(streets, scans, *numbers):
    """Return the index of the threshold chosen from each draw of so many scans; −1 for none."""
    random = np.random.default_rng(1)
    draws = (random.integers(0, len(streets), scans) for _ in range(DRAWS))
    return np.array([held_thresholds(streets[draw], *numbers) - 1 for draw in draws])


@pytest.mark.parametrize(("scans", "level"), [(12, 0.1), (60, 0.05)])
def test_the_expected_loss_of_a_new_scan_is_below_the_level_but_not_far(streets, scans, level):
    held = calibrated(streets, scans, level)
    means = np.append(streets.mean(axis=0), 0)
    loss = means[held].mean()
    noise = 3 * means[held].std() / math.sqrt(DRAWS)
    assert level - 2 / (scans + 1) - noise <= loss <= level + noise


@pytest.mark.parametrize(("scans", "confidence"), [(22, 0.9), (100, 0.8)])
def test_few_scans_lose_more_as_often_as_is_said(streets, scans, confidence):
    held = calibrated(streets, scans, 0.05, confidence)
    losing = np.append((streets > 0.05).mean(axis=0), 0)
    broken = (losing[held] > 1 - confidence).mean()
    noise = 3 * math.sqrt(confidence * (1 - confidence) / DRAWS)
    # No more scans may be bad, by the same bound: so the promise is as tight as whole scans allow.
    likely = binomial(allowed_scans(scans, confidence), scans, 1 - confidence)
    assert likely - noise - 0.02 <= broken <= 1 - confidence + noise


def of_drives(random, drives, scans):
    """Return losses of scans at 200 thresholds, and their drives, which differ by much."""
    hardness = random.beta(1, 4, (drives, 1)) * random.normal(1, 0.15, (drives, scans))
    losses = np.clip(hardness, 0, 1).reshape(-1, 1) * np.linspace(0, 1, 200) ** 2
    return losses, np.repeat(np.arange(drives), scans)


def broken_on_other_drives(drives, scans, *, by_drive=False, draws=500):
    """Return how often the promise of 90 % confidence is broken of other drives."""
    random = np.random.default_rng(2)
    losing = np.append((means_of_units(*of_drives(random, 400, 20)) > 0.05).mean(axis=0), 0)
    held = []
    for _ in range(draws):
        losses, of_scans = of_drives(random, drives, scans)
        units = means_of_units(losses, of_scans) if by_drive else losses
        held.append(held_thresholds(units, 0.05, 0.9) - 1)
    return (losing[held] > 0.1).mean()


def test_a_promise_holds_of_another_drive_if_drives_are_the_unit_and_enough():
    assert broken_on_other_drives(4, 6) > 0.3
    assert broken_on_other_drives(1, 22) > 0.6
    most = 0.1 + 3 * math.sqrt(0.1 * 0.9 / 500)
    assert broken_on_other_drives(22, 6) > 0.2 > most
    assert broken_on_other_drives(22, 6, by_drive=True) < most
    random = np.random.default_rng(3)
    means = np.append(means_of_units(*of_drives(random, 2000, 10)).mean(axis=0), 0)
    drawn = (of_drives(random, 18, 6) for _ in range(500))
    loss = means[[held_thresholds(means_of_units(*draw), 0.1) - 1 for draw in drawn]].mean()
    assert 0.04 < loss < 0.1


def test_a_promise_of_a_class_holds_of_scans_that_have_it_by_the_lower_of_two_thresholds(streets):
    random = np.random.default_rng(4)
    has = random.random(len(streets)) < 0.4
    of_class = np.where(has[:, None], np.minimum(1, 3 * streets), 0)
    found = []
    for _ in range(DRAWS):
        draw = random.integers(0, len(streets), 60)
        with_class = of_class[draw][has[draw]]
        assert len(with_class) >= needed_scans(0.1, None)
        held = held_thresholds(streets[draw], 0.1), held_thresholds(with_class, 0.1)
        lower = min(held) - 1
        found.append((of_class[has][:, lower].mean(), streets[:, lower].mean()))
    found = np.array(found)
    noise = 3 * found.std(axis=0) / math.sqrt(DRAWS)
    assert (found.mean(axis=0) <= 0.1 + noise).all()
    assert found.mean(axis=0)[0] > 0.03


def test_the_loss_of_a_drive_is_the_mean_of_its_scans():
    losses, drives = np.random.default_rng(5).random((7, 3)), np.array([*"bacabba"])
    expected = [losses[drives == drive].mean(axis=0) for drive in "abc"]
    np.testing.assert_allclose(means_of_units(losses, drives), expected)
    np.testing.assert_array_equal(means_of_units(losses, np.arange(7)), losses)
    assert [enough_drives(n, 0.1, None) for n in (17, 18)] == [False, True]
    assert [enough_drives(n, 0.1, 0.9) for n in (21, 22)] == [False, True]


def test_shares_of_scans_by_closed_forms():
    assert binomial(3, 9, 0.3) == pytest.approx(
        sum(math.comb(9, k) * 0.3**k * 0.7 ** (9 - k) for k in range(4))
    )
    assert binomial(9, 9, 0.3) == 1
    assert [allowed_scans(n, 0.95) for n in (58, 59, 92, 93)] == [-1, 0, 0, 1]


@pytest.mark.parametrize("confidence", [None, 0.8, 0.9, 0.95])
@pytest.mark.parametrize("level", [0.03, 0.05, 0.07, 0.1, 1 / 3])
def test_the_number_of_scans_that_is_needed_is_the_least(level, confidence):
    fewest, lossless = needed_scans(level, confidence), np.zeros((500, 1))
    assert held_thresholds(lossless[:fewest], level, confidence) == 1
    assert held_thresholds(lossless[: fewest - 1], level, confidence) == 0


def test_labels_that_are_kept_are_counted():
    space = label_space()
    car, person, rider, road = (
        space.names.index(name) for name in ("car", "person", "bicyclist", "road")
    )
    truth = np.array([0, car, car, person, person, person, road, rider])
    predicted = np.array([car, car, 0, road, person, 0, road, person])
    confusion = confusion_matrix(truth, predicted, space.class_count)
    scans = {"a/0": (20, 4, 2), "a/1": (30, 1, 1), "a/2": (0, 0, 0)}
    kept = AcceptedLabels.of_confusion(confusion, space, scans)
    assert (kept.points, kept.kept, kept.wrong) == (7, 5, 2)
    assert (kept.people, kept.missed_people) == (4, 1)
    assert list(kept.classes.items()) == [("person", (2, 1)), ("car", (1, 0)), ("road", (2, 1))]
    assert kept.worst == ("a/0", 20, 4, 2)
    assert "71.4% of 7 points, of which 40.0%" in next(kept.sentences)


RISK = RiskThreshold("error", 0.25, 0.05, None, 20, ("00", "08"))


def test_what_was_promised_stands_beside_what_was_found():
    scans = {"a/0": (100, 50, 8), "a/1": (200, 50, 4), "a/2": (0, 0, 0)}
    found = RiskBoundCheck.of_scans(RISK, scans)
    assert (found.units, found.above, found.mean, found.worst) == (2, 1, 0.05, 0.08)
    assert not found.is_exceeded
    assert "5.0 % on the mean of 2 scans, 8.0 % in the worst" in found.sentence
    found = RiskBoundCheck.of_scans(replace(RISK, confidence=0.9), scans)
    assert "1 of 2 scans, 8.0 % in the worst" in found.sentence
    assert found.is_exceeded  # Half of them, of one tenth
    assert not RiskBoundCheck.of_scans(replace(RISK, confidence=0.5), scans).is_exceeded
    assert RiskBoundCheck.of_scans(RISK, {"a/2": (0, 0, 0)}) is None
    drives = replace(RISK, at_most=0.04, unit="drive")
    found = RiskBoundCheck.of_scans(drives, scans | {"b/0": (10, 9, 0)})
    assert (found.units, found.above, found.mean, found.worst) == (2, 1, 0.025, 0.05)


def test_a_promise_names_what_it_holds_for():
    assert promise(RISK) == (
        "error up to 0.25 kept: of another scan of the drives that it was chosen on (20 scans of "
        "00, 08), not of others, at most 5 % of the points of known classes are expected to be "
        "kept and wrong"
    )
    sure = promise(replace(RISK, confidence=0.9))
    assert "with 90 % confidence, at most 10 % of scans" in sure
    of_drives = promise(replace(RISK, unit="drive", classes={"car": 0.1}))
    assert ": of another drive like those that it was chosen on (20 scans" in of_drives
    assert of_drives.endswith("; the same of the points labelled as each of car")
    # Classes of which nothing is kept are promised nothing.
    some = {"car": 0.1, "person": ACCEPTS_NONE}
    assert promise(replace(RISK, classes=some)).endswith("labelled as each of car")
    assert promise(replace(RISK, classes={"person": ACCEPTS_NONE})) == promise(RISK)
