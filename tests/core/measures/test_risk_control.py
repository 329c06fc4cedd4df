# SPDX-License-Identifier: MIT
"""Guarantees of thresholds: against closed forms, and by simulation of many calibrations."""

import math
from dataclasses import replace

import numpy as np
import pytest

from salsanext_cli import label_space
from salsanext_cli.core.measures.accepted_labels import AcceptedCounts, AcceptedLabels
from salsanext_cli.core.measures.risk_control import (
    RiskBoundCheck,
    allowed_scans,
    binomial,
    enough_drives,
    guarantee_text,
    held_thresholds,
    means_of_units,
    needed_scans,
)
from salsanext_cli.core.measures.scores import confusion_matrix
from salsanext_cli.core.network.card import RiskThreshold
from salsanext_cli.core.plain_data import plain

DRAWS = 2000


@pytest.fixture(scope="module")
def scenes():
    """Losses of 4,000 scans at 200 rising thresholds; some scans are much harder than others."""
    random = np.random.default_rng(0)
    hardness, shape = random.beta(1, 4, (4000, 1)), random.uniform(1, 4, (4000, 1))
    return hardness * np.linspace(0, 1, 200) ** shape


def calibrated(scenes, scans, *numbers):
    """Return the index of the threshold chosen from each draw of so many scans; −1 for none."""
    random = np.random.default_rng(1)
    draws = (random.integers(0, len(scenes), scans) for _ in range(DRAWS))
    return np.array([held_thresholds(scenes[draw], *numbers) - 1 for draw in draws])


@pytest.mark.parametrize(("scans", "level"), [(12, 0.1), (60, 0.05)])
def test_the_expected_loss_of_a_new_scan_is_below_the_level_but_not_far(scenes, scans, level):
    held = calibrated(scenes, scans, level)
    means = np.append(scenes.mean(axis=0), 0)
    loss = means[held].mean()
    noise = 3 * means[held].std() / math.sqrt(DRAWS)
    assert level - 2 / (scans + 1) - noise <= loss <= level + noise


@pytest.mark.parametrize(("scans", "confidence"), [(22, 0.9), (100, 0.8)])
def test_few_scans_lose_more_as_often_as_guaranteed(scenes, scans, confidence):
    held = calibrated(scenes, scans, 0.05, confidence)
    losing = np.append((scenes > 0.05).mean(axis=0), 0)
    broken = (losing[held] > 1 - confidence).mean()
    noise = 3 * math.sqrt(confidence * (1 - confidence) / DRAWS)
    # The bound allows no more bad scans, so the guarantee is as tight as whole scans allow.
    likely = binomial(allowed_scans(scans, confidence), scans, 1 - confidence)
    assert likely - noise - 0.02 <= broken <= 1 - confidence + noise


def of_drives(random, drives, scans):
    """Return losses of scans at 200 thresholds, and their drives, which differ by much."""
    hardness = random.beta(1, 4, (drives, 1)) * random.normal(1, 0.15, (drives, scans))
    losses = np.clip(hardness, 0, 1).reshape(-1, 1) * np.linspace(0, 1, 200) ** 2
    return losses, np.repeat(np.arange(drives), scans)


def broken_on_other_drives(drives, scans, *, by_drive=False, draws=500):
    """Return how often other drives break a guarantee of 90 % confidence."""
    random = np.random.default_rng(2)
    losing = np.append((means_of_units(*of_drives(random, 400, 20)) > 0.05).mean(axis=0), 0)
    held = []
    for _ in range(draws):
        losses, of_scans = of_drives(random, drives, scans)
        units = means_of_units(losses, of_scans) if by_drive else losses
        held.append(held_thresholds(units, 0.05, 0.9) - 1)
    return (losing[held] > 0.1).mean()


def test_a_guarantee_holds_for_other_drives_if_enough_drives_are_the_unit():
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


def test_consecutive_scans_guarantee_nothing_about_the_rest_of_their_drive():
    # A drive from a village into a forest, where more and more labels are wrong
    drive = np.linspace(0.05, 0.6, 600)[:, None] * np.linspace(0, 1, 200)
    first = held_thresholds(drive[:60], 0.1) - 1
    assert drive[60:, first].mean() > 0.3
    random = np.random.default_rng(6)
    losses = []
    for _ in range(500):
        order = random.permutation(600)
        drawn = held_thresholds(drive[order[:60]], 0.1) - 1
        losses.append(drive[order[60:], drawn].mean())
    assert 0.08 < np.mean(losses) <= 0.1


@pytest.fixture(scope="module")
def rarely_bad():
    """Losses of 4,000 scans: one in 33 may be wrong everywhere, the others in up to 9.9 %."""
    is_bad = np.random.default_rng(7).random((4000, 1)) < 0.03
    return np.where(is_bad, 1, 0.099) * np.linspace(0, 1, 200)


def test_an_average_is_also_over_the_choices_of_labelled_scans(rarely_bad):
    means = np.append(rarely_bad.mean(axis=0), 0)[calibrated(rarely_bad, 100, 0.1)]
    assert means.mean() <= 0.1
    # Single choices give a threshold whose average exceeds the limit for good.
    assert (means > 0.1).mean() > 0.2


def test_a_confidence_does_not_limit_the_average(rarely_bad):
    held = calibrated(rarely_bad, 100, 0.1, 0.9)
    above = np.append((rarely_bad > 0.1).mean(axis=0), 0)
    assert (above[held] > 0.1).mean() <= 0.1
    assert np.append(rarely_bad.mean(axis=0), 0)[held].mean() > 0.1


def test_a_confidence_about_drives_needs_as_many_scans_of_each():
    random = np.random.default_rng(9)

    def drives(count, scans):
        rate = random.beta(2, 30, (count, 1))
        is_bad = random.random((count, scans)) < rate
        return is_bad.mean(axis=1, keepdims=True) * np.linspace(0, 1, 101)

    above = np.append((drives(4000, 20) > 0.1).mean(axis=0), 0)
    broken = {}
    for scans in (1, 20):
        held = [held_thresholds(drives(38, scans), 0.1, 0.9) - 1 for _ in range(500)]
        broken[scans] = (above[held] > 0.1).mean()
    assert broken[20] <= 0.1
    assert broken[1] > 0.2


def test_a_guarantee_for_a_class_holds_with_the_lower_of_two_thresholds(scenes):
    random = np.random.default_rng(4)
    has = random.random(len(scenes)) < 0.4
    of_class = np.where(has[:, None], np.minimum(1, 3 * scenes), 0)
    losses = []
    for _ in range(DRAWS):
        draw = random.integers(0, len(scenes), 60)
        with_class = of_class[draw][has[draw]]
        assert len(with_class) >= needed_scans(0.1, None)
        held = held_thresholds(scenes[draw], 0.1), held_thresholds(with_class, 0.1)
        lower = min(held) - 1
        losses.append((of_class[has][:, lower].mean(), scenes[:, lower].mean()))
    losses = np.array(losses)
    noise = 3 * losses.std(axis=0) / math.sqrt(DRAWS)
    assert (losses.mean(axis=0) <= 0.1 + noise).all()
    assert losses.mean(axis=0)[0] > 0.03


def test_the_loss_of_a_drive_is_the_mean_of_its_scans():
    losses, drives = np.random.default_rng(5).random((7, 3)), np.array([*"bacabba"])
    expected = [losses[drives == drive].mean(axis=0) for drive in "abc"]
    np.testing.assert_allclose(means_of_units(losses, drives), expected)
    np.testing.assert_array_equal(means_of_units(losses, np.arange(7)), losses)
    assert [enough_drives(n, 0.1, None) for n in (17, 18)] == [False, True]
    assert [enough_drives(n, 0.1, 0.9) for n in (21, 22)] == [False, True]


def test_shares_of_scans_by_closed_forms():
    expected = sum(math.comb(9, k) * 0.3**k * 0.7 ** (9 - k) for k in range(4))
    assert binomial(3, 9, 0.3) == pytest.approx(expected)
    assert binomial(9, 9, 0.3) == 1
    assert [allowed_scans(n, 0.95) for n in (58, 59, 92, 93)] == [-1, 0, 0, 1]


@pytest.mark.parametrize("confidence", [None, 0.8, 0.9, 0.95])
@pytest.mark.parametrize("level", [0.03, 0.05, 0.07, 0.1, 1 / 3])
def test_the_number_of_needed_scans_is_the_least(level, confidence):
    fewest, lossless = needed_scans(level, confidence), np.zeros((500, 1))
    assert held_thresholds(lossless[:fewest], level, confidence) == 1
    assert held_thresholds(lossless[: fewest - 1], level, confidence) == 0


def accepted(scans):
    """Return points of scans by name from numbers of scored, accepted and wrong ones."""
    return {
        name: AcceptedCounts(points=points, accepted=with_label, wrong=wrong)
        for name, (points, with_label, wrong) in scans.items()
    }


def test_accepted_labels_are_counted():
    space = label_space()
    car, person, rider, road = map(space.names.index, ("car", "person", "bicyclist", "road"))
    truth = np.array([0, car, car, person, person, person, road, rider])
    predicted = np.array([car, car, 0, road, person, 0, road, person])
    confusion = confusion_matrix(truth, predicted, space.class_count)
    scans = accepted({"a/0": (20, 4, 2), "a/1": (30, 1, 1), "a/2": (0, 0, 0)})
    labels = AcceptedLabels.from_confusion(confusion, space, scans)
    assert (labels.points, labels.accepted, labels.wrong) == (7, 5, 2)
    assert (labels.people, labels.missed_people) == (4, 1)
    assert list(labels.classes.items()) == [("person", (2, 1)), ("car", (1, 0)), ("road", (2, 1))]
    assert labels.worst_scan == "a/0"
    assert labels.worst == AcceptedCounts(points=20, accepted=4, wrong=2)
    assert plain(labels)["worst"] == ["a/0", 20, 4, 2]
    first = next(labels.sentences)
    assert "71.4 %" in first
    assert "40.0 %" in first


RISK = RiskThreshold("error", 0.25, 0.05, None, 20, ("00", "08"))
SCANS = {"a/0": (100, 50, 8), "a/1": (200, 50, 4), "a/2": (0, 0, 0)}
"""Scored, accepted and wrong points."""


@pytest.mark.parametrize(
    ("change", "more", "numbers", "is_exceeded"),
    [
        ({}, {}, (2, 1, 0.05, 0.08), False),
        ({"confidence": 0.9}, {}, (2, 1, 0.05, 0.08), True),  # Half of them, of one tenth
        ({"confidence": 0.5}, {}, (2, 1, 0.05, 0.08), False),
        ({"at_most": 0.04, "unit": "drive"}, {"b/0": (10, 9, 0)}, (2, 1, 0.025, 0.05), False),
    ],
)
def test_losses_are_compared_with_the_guarantee(change, more, numbers, is_exceeded):
    check = RiskBoundCheck.from_scans(replace(RISK, **change), accepted(SCANS | more))
    assert (check.units, check.above, check.mean, check.worst) == numbers
    assert bool(check.warning) == is_exceeded
    assert f"{100 * check.worst:.1f} % in the worst" in check.sentence


def test_no_points_are_no_check_of_a_guarantee():
    assert RiskBoundCheck.from_scans(RISK, accepted({"a/2": (0, 0, 0)})) is None


def test_a_guarantee_states_its_scope():
    assert guarantee_text(RISK) == (
        "error up to 0.25 accepted: on average over new scans and over choices of the labelled "
        "ones, at most 5 % of the points of known classes are accepted and wrong, for scans drawn "
        "in the same way from the drives that the threshold was chosen on (20 scans of 00, 08), "
        "not others"
    )
    named = guarantee_text(replace(RISK, data_set="semantickitti"))
    assert "(20 scans of semantickitti: 00, 08)" in named
    assert "with 90 % confidence, at most 10 % of scans" in guarantee_text(
        replace(RISK, confidence=0.9)
    )
    of_drives = guarantee_text(replace(RISK, unit="drive"))
    assert "for drives like those that the threshold was chosen on (20 scans" in of_drives


def test_a_threshold_of_consecutive_scans_is_not_called_guaranteed():
    consecutive = replace(RISK, consecutive=True)
    assert "not guaranteed" in guarantee_text(consecutive)
    assert "not guaranteed" not in guarantee_text(RISK)
    check = RiskBoundCheck.from_scans(consecutive, accepted(SCANS))
    assert check.sentence.startswith("not guaranteed")


def test_scans_that_cannot_be_compared_are_not_called_guaranteed():
    check = RiskBoundCheck.from_scans(RISK, accepted(SCANS))
    assert check.sentence.startswith("guaranteed for scans ")
    assert "guaranteed" not in replace(check, incomparable="1 drive").sentence
    # Evidence that they are others says more.
    others = replace(check, incomparable="1 drive", are_others=True)
    assert others.sentence.startswith("not guaranteed")
