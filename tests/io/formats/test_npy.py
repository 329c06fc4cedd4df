# SPDX-License-Identifier: MIT
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scans import write_array

from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.formats.npy import read_array, read_probabilities, read_uncertainty
from salsanext_cli.runs.results.output_run import encode_array

DTYPES = st.sampled_from([np.float32, np.float16, np.int32, np.uint8])


@given(DTYPES.flatmap(lambda t: hnp.arrays(t, hnp.array_shapes(min_dims=1, min_side=0))))
def test_round_trip_and_the_bytes_of_numpy(tmp_path_factory, array):
    path = tmp_path_factory.mktemp("npy") / "a.npy"
    np.save(path, array)
    assert encode_array(array) == path.read_bytes()
    back = read_array(path, array.dtype, (None,) * array.ndim)
    np.testing.assert_array_equal(back, array)
    assert back.flags.writeable


@pytest.mark.parametrize(
    ("dtype", "shape"),
    [("f8", (5, 4)), ("i4", (5, 4)), (">f4", (5, 4)), ("f4", (4, 5)), ("f4", (5,)), ("f4", ())],
)
def test_another_dtype_or_shape_is_refused(tmp_path, dtype, shape):
    path = tmp_path / "a.npy"
    np.save(path, np.zeros(shape, dtype))
    with pytest.raises(FormatError, match=r"expected a \.npy file of float32 \(5, any\)") as caught:
        read_array(path, np.float32, (5, None))
    assert np.dtype(dtype).str in caught.value.problem


class Trap:
    """Run code when unpickled."""

    def __reduce__(self):
        return (exec, ("raise SystemExit('code of a file was run')",))


def test_pickles_are_not_opened(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.array([Trap()], object), allow_pickle=True)
    with pytest.raises(FormatError, match="npy file of object"):
        read_array(path, np.float32, (None,))
    path.write_bytes(pickle.dumps(Trap()))
    with pytest.raises(FormatError, match="magic string"):
        read_array(path, np.float32, (None,))


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


@pytest.mark.parametrize(
    "row", [(0.5, 0.4), (np.nan, 1), (1.5, -0.5), (np.inf, 0), (1.002, 0)], ids=str
)
def test_invalid_probabilities_are_refused(path, row):
    write_array(path, np.array([(1, 0), row, (0, 1)], np.float16))
    with pytest.raises(FormatError, match=r"000000\.npy: .* at 1 of 3 points"):
        read_probabilities(path, 3, 2)


def test_uncertainties_are_read_with_their_gaps(path):
    values = np.array([0, 0.5, np.nan], np.float32)
    write_array(path, values)
    np.testing.assert_array_equal(read_uncertainty(path, 3), values)
    for count in (0, 2, 4):
        with pytest.raises(FormatError, match=rf"float32 \({count}\)"):
            read_uncertainty(path, count)


@pytest.mark.parametrize("highest", [np.inf, 1])
@pytest.mark.parametrize("value", [-1e-9, np.inf, -np.inf, 1.0000001])
def test_impossible_uncertainties_are_refused(path, highest, value):
    write_array(path, np.array([0, 1, np.nan, value], np.float32))
    if highest < value or not 0 <= value < np.inf:
        with pytest.raises(FormatError, match="at 1 of 4 points"):
            read_uncertainty(path, 4, highest)
    else:
        assert np.nanmax(read_uncertainty(path, 4, highest)) > 1
