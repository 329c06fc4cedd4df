# SPDX-License-Identifier: MIT
"""Labels that are rejected by their uncertainty."""

import numpy as np
import pytest

from salsanext_cli.commands.jobs.label_rejection import LabelRejection
from salsanext_cli.runs.records.stage_settings import PredictSettings

UNCERTAINTY = np.float32([0.0, 0.1, np.nextafter(np.float32(0.1), np.float32(1)), np.nan, 1.0])


def test_labels_above_the_threshold_are_rejected_and_those_without_a_number_are_not():
    """The threshold is compared in float32, in which 0.1 is a little more."""
    rejection = LabelRejection(kind="error", threshold=0.1, risk=None)
    expected = [False, False, True, False, True]
    assert rejection.rejected(UNCERTAINTY).tolist() == expected


@pytest.mark.parametrize(("kind", "recorded"), [("error", None), ("least_confidence", "same")])
def test_the_record_has_the_rule_and_no_accuracy(kind, recorded):
    rejection = LabelRejection(kind=kind, threshold=0.25, risk=None)
    settings = rejection.recorded_in(PredictSettings())
    assert settings.reject == 0.25
    assert settings.reject_by == (kind if recorded else None)
    assert settings.guarantee is None
    assert settings.accuracy is None
