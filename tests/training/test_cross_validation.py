# SPDX-License-Identifier: MIT
import math
from itertools import chain
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.results.layout import ScanFile
from salsanext_cli.training.cross_validation import expectation, folds


def scans(*lengths: int) -> list[ScanFile]:
    """Return scans of sequences of some lengths."""
    return [
        ScanFile(f"{name:02}", str(i), Path(f"{name}/velodyne/{i}.bin"))
        for name, length in enumerate(lengths)
        for i in range(length)
    ]


@given(st.lists(st.integers(1, 6), min_size=1, max_size=8), st.integers(2, 6))
def test_every_scan_is_left_out_once_and_no_fold_is_empty(lengths: list[int], count: int) -> None:
    files = scans(*lengths)
    found = folds(files, count)
    assert sorted(chain(*found), key=files.index) == files
    assert all(found)
    assert len(found) == min(count, len(lengths) if len(lengths) > 1 else len(files))
    if len(lengths) > 1:
        places = [{file.sequence for file in fold} for fold in found]
        assert sum(map(len, places)) == len(lengths), "a sequence in two folds"


def test_folds_of_one_sequence_are_neighbours_and_those_of_two_are_these() -> None:
    files = scans(7)
    assert folds(files, 3) == [files[:3], files[3:5], files[5:]]
    files = scans(5, 2)
    assert folds(files, 3) == [files[:5], files[5:]]


def row(
    epoch: int, miou: float, accuracy: float = 0.5, temperature: float = 1.0
) -> dict[str, float]:
    return {"epoch": epoch, "miou": miou, "accuracy": accuracy, "temperature": temperature}


def test_the_epochs_of_the_highest_mean_are_chosen() -> None:
    logs = [
        [row(1, 0.2), row(2, 0.5, 0.8, 0.5), row(3, 0.4)],
        [row(1, 0.3), row(2, 0.3, 0.6, 2.0), row(3, 0.4)],
    ]
    found = expectation(logs)
    assert found is not None
    # 0.4 twice: the fewer epochs win.
    assert (found.epochs, found.folds) == (2, 2)
    # The first fold is scored after 3 epochs, the best number of the second; the second after 2.
    assert (found.miou, found.accuracy) == pytest.approx((0.35, 0.55))
    assert (found.miou_spread, found.accuracy_spread) == pytest.approx((math.sqrt(0.005),) * 2)
    assert found.temperature == pytest.approx(1.0)


def test_a_fold_without_classes_that_count_does_not_count() -> None:
    nothing = [row(1, math.nan), row(2, math.nan)]
    found = expectation([nothing, [row(1, 0.2), row(2, 0.3)]])
    assert found is not None
    assert (found.epochs, found.folds, found.miou, found.miou_spread) == (2, 1, 0.3, None)
    assert expectation([nothing]) is None
