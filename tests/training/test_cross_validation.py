# SPDX-License-Identifier: MIT
"""Folds of cross-validation, and the epochs that they choose."""

import math
from itertools import chain
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training.cross_validation import expectation, folds, held_out


def scans(*lengths: int) -> list[ScanFile]:
    """Return scans of sequences of some lengths."""
    return [
        ScanFile(sequence=f"{name:02}", stem=str(i), path=Path(f"{name}/velodyne/{i}.bin"))
        for name, length in enumerate(lengths)
        for i in range(length)
    ]


@given(st.lists(st.integers(1, 6), min_size=1, max_size=8), st.integers(2, 6))
def test_every_scan_is_held_out_once_and_no_fold_is_empty(lengths: list[int], count: int) -> None:
    files = scans(*lengths)
    parts = folds(files, count)
    assert sorted(chain(*parts), key=files.index) == files
    assert all(parts)
    assert len(parts) == min(count, len(lengths) if len(lengths) > 1 else len(files))
    if len(lengths) > 1:
        sequences = [{file.sequence for file in part} for part in parts]
        assert sum(map(len, sequences)) == len(lengths), "a sequence in two folds"


def test_folds_of_one_sequence_are_neighbours_and_of_several_whole_sequences() -> None:
    files = scans(7)
    assert folds(files, 3) == [files[:3], files[3:5], files[5:]]
    files = scans(5, 2)
    assert folds(files, 3) == [files[:5], files[5:]]


def row(epoch, miou, accuracy=0.5, temperature=1.0):
    return {"epoch": epoch, "miou": miou, "accuracy": accuracy, "temperature": temperature}


def test_the_epochs_of_the_highest_mean_over_scored_folds_are_chosen():
    logs = [
        [row(1, 0.2), row(2, 0.5, 0.8, 0.5), row(3, 0.4)],
        [row(1, 0.3), row(2, 0.3, 0.6, 2.0), row(3, 0.4)],
    ]
    expected = expectation(logs)
    # 0.4 twice: the fewer epochs win.
    assert (expected.epochs, expected.folds) == (2, 2)
    # The first fold is scored after 3 epochs, the best number of the second; the second after 2.
    assert (expected.miou, expected.accuracy) == pytest.approx((0.35, 0.55))
    spreads = (expected.miou_spread, expected.accuracy_spread)
    assert spreads == pytest.approx((math.sqrt(0.005),) * 2)
    assert expected.temperature == pytest.approx(1.0)
    nothing = [row(1, math.nan), row(2, math.nan)]
    one = expectation([nothing, [row(1, 0.2), row(2, 0.3)]])
    assert (one.epochs, one.folds, one.miou, one.miou_spread) == (2, 1, 0.3, None)
    assert expectation([nothing]) is None


def test_scans_of_folds_are_not_compared_with_each_other(monkeypatch):
    files = scans(90, 30, 60, 20)
    compared = []
    is_equal = ScanFile.__eq__

    def noted(file, other):
        compared.append(file)
        return is_equal(file, other)

    monkeypatch.setattr(ScanFile, "__eq__", noted)
    parts = held_out(files, 3)
    assert len(compared) <= len(files)
    monkeypatch.undo()
    for others, fold in parts:
        assert others == [file for file in files if file not in fold]
