# SPDX-License-Identifier: MIT
"""Images and intensities that differ from those of the training."""

from dataclasses import replace

import pytest
from scans import SMALL

from salsanext_cli.core.checks.training_checks import MAX_USUAL_INTENSITY, training_findings
from salsanext_cli.core.geometry.intensity import BRIGHT_LEVEL, INTENSITY_FACTOR, INTENSITY_LEVELS

TRAINED = replace(SMALL, intensity_quantiles=(), row_gaps=None)
BRIGHT = 0.5
"""Upper intensity of the training scans in the tests."""


def with_quantiles(sensor):
    """Return a sensor whose upper intensity is `BRIGHT`."""
    quantiles = tuple(BRIGHT * level / BRIGHT_LEVEL for level in range(INTENSITY_LEVELS))
    return replace(sensor, intensity_quantiles=quantiles)


def codes(bright, sensor, trained, reason=""):
    return [str(finding.code) for finding in training_findings(bright, reason, sensor, trained)]


def test_the_images_of_the_training_give_no_finding():
    assert codes(BRIGHT, TRAINED, TRAINED) == []


@pytest.mark.parametrize(
    "change",
    [
        {"width": 2 * SMALL.width},
        {"height": 2 * SMALL.height},
        {"means": (1.0, 0, 0, 0, 0)},
        {"stds": (1.0, 2, 3, 4, 5)},
    ],
)
def test_other_sizes_and_normalisations_are_found(change):
    assert codes(BRIGHT, replace(TRAINED, **change), TRAINED) == ["other-images"]


@pytest.mark.parametrize(
    ("bright", "is_doubtful"), [(0, False), (MAX_USUAL_INTENSITY, False), (255, True), (-0.1, True)]
)
def test_the_scale_is_0_to_1_if_that_of_the_training_is_unknown(bright, is_doubtful):
    assert codes(bright, TRAINED, TRAINED) == ["intensity-scale"] * is_doubtful


@pytest.mark.parametrize(
    ("factor", "is_doubtful"),
    [
        (1.01 / INTENSITY_FACTOR, False),
        (0.99 * INTENSITY_FACTOR, False),
        (0.99 / INTENSITY_FACTOR, True),
        (1.01 * INTENSITY_FACTOR, True),
    ],
)
def test_the_scale_is_compared_by_a_factor_with_a_known_one(factor, is_doubtful):
    trained = with_quantiles(TRAINED)
    assert codes(factor * BRIGHT, TRAINED, trained) == ["intensity-scale"] * is_doubtful
    # If it was matched, with that of the scans fitted to
    fitted = with_quantiles(TRAINED)
    assert codes(factor * BRIGHT, fitted, TRAINED) == ["intensity-scale"] * is_doubtful


def test_values_that_are_no_intensities_have_no_scale():
    assert codes(255, TRAINED, TRAINED, "all values are 0") == ["no-intensity"]


@pytest.mark.parametrize(("fields", "named"), [((), "columns"), (("ring", "t"), "ring")])
def test_the_hint_names_the_fields_of_the_file(fields, named):
    (finding,) = training_findings(1, "all values are 0", TRAINED, TRAINED, fields)
    assert named in finding.hint
