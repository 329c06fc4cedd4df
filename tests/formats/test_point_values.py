# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from scans import write_array

from salsanext_cli.errors import FormatError
from salsanext_cli.formats.point_values import read_probabilities, read_uncertainty


@pytest.fixture
def path(tmp_path):
    return tmp_path / "000000.npy"


@pytest.mark.parametrize(("count", "scale"), [(0, 1), (2000, 0.1), (2000, 1), (2000, 30)])
def test_every_softmax_rounded_to_float16_is_read(path, count, scale):
    logits = np.random.default_rng(0).normal(0, scale, (count, 20))
    powers = np.exp(logits - logits.max(axis=1, keepdims=True))
    rounded = (powers / powers.sum(axis=1, keepdims=True)).astype(np.float16)
    write_array(path, rounded)
    np.testing.assert_array_equal(read_probabilities(path, count, 20), rounded)


@pytest.mark.parametrize("row", [(0.5, 0.4), (np.nan, 1), (1.5, -0.5), (np.inf, 0)], ids=str)
def test_invalid_probabilities_are_refused(path, row):
    write_array(path, np.array([(1, 0), row, (0, 1)], np.float16))
    with pytest.raises(FormatError, match=r"000000\.npy · NaN or no probabilities at 1 of 3 point"):
        read_probabilities(path, 3, 2)


def test_uncertainties_are_read_with_their_gaps(path):
    values = np.array([0, 0.5, np.nan], np.float32)
    write_array(path, values)
    np.testing.assert_array_equal(read_uncertainty(path, 3), values)
    for count in (0, 2, 4):
        with pytest.raises(FormatError, match=rf"float32 \({count}\)"):
            read_uncertainty(path, count)


@pytest.mark.parametrize("value", [-1e-9, np.inf, -np.inf])
def test_invalid_uncertainties_are_refused(path, value):
    write_array(path, np.array([0.1, value], np.float32))
    with pytest.raises(FormatError, match=r"negative or infinite at 1 of 2 points"):
        read_uncertainty(path, 2)
