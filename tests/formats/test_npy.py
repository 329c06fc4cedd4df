# SPDX-License-Identifier: MIT
import io
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from salsanext_cli.errors import FormatError
from salsanext_cli.formats.npy import read_array
from salsanext_cli.storage.point_files import write_array

DTYPES = st.sampled_from([np.float32, np.float16, np.int32, np.uint8])


@given(DTYPES.flatmap(lambda t: hnp.arrays(t, hnp.array_shapes(min_dims=1, min_side=0))))
@settings(max_examples=50, deadline=None)
def test_round_trip_and_the_bytes_of_numpy(
    tmp_path_factory: pytest.TempPathFactory, array: np.ndarray
) -> None:
    path = tmp_path_factory.mktemp("npy") / "a.npy"
    write_array(path, array)
    back = read_array(path, array.dtype, (None,) * array.ndim)
    np.testing.assert_array_equal(back, array)
    assert back.flags.writeable
    reference = io.BytesIO()
    np.save(reference, array)
    assert path.read_bytes() == reference.getvalue()


def test_arrays_of_other_memory_order(tmp_path: Path) -> None:
    array = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    np.save(tmp_path / "f.npy", np.asfortranarray(array))
    np.testing.assert_array_equal(read_array(tmp_path / "f.npy", "f4", (2, 3, 4)), array)
    write_array(tmp_path / "t.npy", array.T)
    np.testing.assert_array_equal(np.load(tmp_path / "t.npy"), array.T)


@pytest.mark.parametrize(
    ("dtype", "shape"),
    [("f8", (5, 4)), ("i4", (5, 4)), (">f4", (5, 4)), ("f4", (4, 5)), ("f4", (5,)), ("f4", ())],
)
def test_another_dtype_or_shape_is_refused(
    tmp_path: Path, dtype: str, shape: tuple[int, ...]
) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.zeros(shape, dtype))
    with pytest.raises(FormatError, match=r"expected a \.npy file of float32 \(5, any\)") as caught:
        read_array(path, np.float32, (5, None))
    assert np.dtype(dtype).str in caught.value.found


@pytest.mark.parametrize("cut", [0, 1, 6, 8, 10, 64, 127, 128, 200, 287])
def test_truncated(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.zeros(40, np.float32))
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(FormatError):
        read_array(path, np.float32, (None,))


def test_trailing_bytes(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.zeros(4, np.float32))
    path.write_bytes(path.read_bytes() + b"x")
    with pytest.raises(FormatError, match="17 bytes of data"):
        read_array(path, np.float32, (None,))


@pytest.mark.parametrize("shape", [(10**15,), (10**30,), (-1,), (2**40, 2**40)])
def test_header_that_promises_more_than_the_file_holds(
    tmp_path: Path, shape: tuple[int, ...]
) -> None:
    path = tmp_path / "a.npy"
    with path.open("wb") as file:
        header = {"descr": "<f4", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, header)
        file.write(bytes(16))
    with pytest.raises(FormatError):
        read_array(path, np.float32, (None,) * len(shape))


class Trap:
    """Run code when unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (exec, ("raise SystemExit('code of a file was run')",))


def test_pickles_are_not_opened(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.array([Trap()], object), allow_pickle=True)
    with pytest.raises(FormatError, match=r"\|O"):
        read_array(path, np.float32, (None,))
    path.write_bytes(pickle.dumps(Trap()))
    with pytest.raises(FormatError, match=r"not a \.npy file"):
        read_array(path, np.float32, (None,))


@given(st.binary(max_size=300))
@settings(max_examples=100, deadline=None)
def test_any_bytes_are_refused_politely(
    tmp_path_factory: pytest.TempPathFactory, junk: bytes
) -> None:
    path = tmp_path_factory.mktemp("junk") / "a.npy"
    path.write_bytes(junk)
    with pytest.raises(FormatError):
        read_array(path, np.float32, (None,))


@given(st.integers(0, 127), st.integers(0, 255))
@settings(max_examples=200, deadline=None)
def test_a_damaged_header_is_refused_or_harmless(
    tmp_path_factory: pytest.TempPathFactory, position: int, value: int
) -> None:
    buffer = io.BytesIO()
    np.save(buffer, np.arange(10, dtype=np.float32))
    damaged = bytearray(buffer.getvalue())
    damaged[position] = value
    path = tmp_path_factory.mktemp("damaged") / "a.npy"
    path.write_bytes(damaged)
    try:
        array = read_array(path, np.float32, (None,))
    except FormatError:
        return
    np.testing.assert_array_equal(array, np.arange(10, dtype=np.float32))


def test_missing_and_folder(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="no such file"):
        read_array(tmp_path / "a.npy", np.float32, (None,))
    with pytest.raises(FormatError, match="is a directory"):
        read_array(tmp_path, np.float32, (None,))


@pytest.mark.parametrize(
    "lengths", [b"5, 0, 999999999999999999", b"5, 0, 1 2", b"5, 0, 9" + b"9" * 30]
)
def test_impossible_shapes_of_nothing(tmp_path: Path, lengths: bytes) -> None:
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (" + lengths + b"), }"
    header = header.ljust(117) + b"\n"
    path = tmp_path / "x.npy"
    path.write_bytes(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    with pytest.raises(FormatError, match="impossible shape"):
        read_array(path, "float32", (5, None, None))
