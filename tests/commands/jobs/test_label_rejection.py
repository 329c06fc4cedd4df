# SPDX-License-Identifier: MIT
"""Labels that are rejected by their uncertainty."""

from types import SimpleNamespace

import numpy as np
import pytest

from salsanext_cli.commands.jobs import label_rejection as module
from salsanext_cli.commands.jobs.label_rejection import LabelRejection, label_rejection
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.network.tuned_settings import KEY_OF
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


TILES = "int8 with bfloat16 and tiles of bytes"


@pytest.mark.parametrize(
    ("tuned", "current", "has_the_option"),
    [("int8", TILES, True), (TILES, "int8", True), ("float32", "int8", False)],
)
def test_the_hint_about_another_kind_of_cpu_is_no_option_of_this_one(
    monkeypatch, tuned, current, has_the_option
):
    key = KEY_OF["precision"]
    current_settings = dict.fromkeys(KEY_OF.values()) | {key: current}
    monkeypatch.setattr(module, "label_settings", lambda *_: current_settings)
    risk = SimpleNamespace(settings={key: tuned})
    network = SimpleNamespace(card=SimpleNamespace(risk=risk), merging=None)
    with pytest.raises(UsageError) as caught:
        label_rejection("risk", SimpleNamespace(), network, KnnParameters())
    assert "`tune risk` again" in caught.value.hint
    assert ("use the option" in caught.value.hint) is not has_the_option
    assert ("on a CPU with bfloat16 and tiles of bytes" in caught.value.problem) is (tuned == TILES)
