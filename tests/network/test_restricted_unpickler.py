# SPDX-License-Identifier: MIT
"""Files of `torch.save`: read as torch reads them, and files that were made to do harm."""

import argparse
import functools
import io
import os
import pickle
import struct
import time
import zipfile
from collections import OrderedDict, defaultdict
from pathlib import Path

import numpy as np
import pytest
import torch
from fuzzing.limits import bounded
from torch import nn

from salsanext_cli.errors import WeightsError
from salsanext_cli.network.published import read_torch_file
from salsanext_cli.network.restricted_unpickler import MAX_OPERATIONS, Opaque

FORMS = pytest.mark.parametrize("as_zip", [True, False], ids=["zip", "legacy"])
PROTOCOL, STOP, NEVER_RUN = b"\x80\x02", b".", "touched"


def save(path, content, as_zip):
    torch.save(content, path, _use_new_zipfile_serialization=as_zip)
    return path


def archive(pickled, **members):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as file:
        for name, data in {"data.pkl": pickled, **members}.items():
            file.writestr(f"a/{name}", data)
    return stream.getvalue()


def legacy(pickled, keys=b"]."):
    head = b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M\xe9\x03.\x80\x02}."
    return head + pickled + PROTOCOL + keys


def refused(path, content):
    """Return what is said of a file that is refused, in two seconds and little memory."""
    path.write_bytes(content)
    with bounded(len(content)), pytest.raises(WeightsError) as caught:
        read_torch_file(path)
    assert len(str(caught.value)) < 600
    return str(caught.value)


# What torch writes


@FORMS
def test_plain_values_and_tensors_are_those_that_torch_reads(tmp_path, as_zip):
    strided = torch.arange(24.0).view(2, 3, 4).permute(2, 0, 1)[1:]
    dtypes = (torch.float64, torch.float16, torch.bfloat16, torch.int64, torch.uint8, torch.bool)
    content = {
        "values": [1, -(2**40), 2.5, "ä", None, True, (), (1,), (1, 2, (3, 4, 5)), {}, {3: []}],
        "tensors": {str(dtype): torch.arange(5).to(dtype) for dtype in dtypes},
        "views": (strided, strided[0], torch.empty(0, 3), torch.tensor(7), torch.ones(1).expand(1)),
        "nested": OrderedDict(a=OrderedDict(b=1)),
    }
    path = save(tmp_path / "a.pt", content, as_zip)
    found, expected = read_torch_file(path), torch.load(path, weights_only=True)
    assert found["values"] == expected["values"]
    assert found["nested"] == expected["nested"]
    for name in ("tensors", "views"):
        ours, theirs = (
            list(getattr(x[name], "values", lambda v=x[name]: v)()) for x in (found, expected)
        )
        for one, other in zip(ours, theirs, strict=True):
            assert one.dtype == other.dtype
            assert one.stride() == other.stride()
            assert torch.equal(one, other)


@pytest.mark.real
def test_the_published_file_is_read_as_torch_reads_it(golden):
    found = read_torch_file(golden / "SalsaNext")
    expected = torch.load(golden / "SalsaNext", weights_only=True, map_location="cpu")
    assert list(found["state_dict"]) == list(expected["state_dict"])
    for key, tensor in expected["state_dict"].items():
        assert torch.equal(found["state_dict"][key], tensor), key


@FORMS
def test_other_objects_become_their_names(tmp_path, as_zip):
    """Python 2's names too, by which pickles call built-in classes."""
    content = {
        "parameter": nn.Parameter(torch.ones(2)),
        "info": [torch.device("cpu"), {1, 2}, np.float64(0.5), argparse.Namespace(epochs=150)],
        "by": defaultdict(dict, {1: {}}),
        "step": functools.partial(max, 1),
        "kind": dict,
        "keys": {(1, 2): 3, None: 4, "a": 5},
    }
    path = save(tmp_path / "a.pt", content, as_zip)
    found = read_torch_file(path)
    assert torch.equal(found["parameter"], torch.ones(2))
    assert all(isinstance(value, Opaque) for value in found["info"])
    assert found["by"] == Opaque("collections.defaultdict")
    assert found["kind"] == Opaque("__builtin__.dict")
    assert isinstance(found["step"], Opaque)
    assert found["keys"] == {"a": 5}


SPECIAL = {
    "float8": lambda: torch.ones(2).to(torch.float8_e4m3fn),
    "complex": lambda: torch.ones(2, dtype=torch.complex64),
    "conjugate": lambda: torch.ones(2, dtype=torch.complex64).conj(),
    "sparse": lambda: torch.ones(2).to_sparse(),
    "csr": lambda: torch.ones(2, 2).to_sparse_csr(),
    "meta": lambda: torch.ones(2, device="meta"),
    "quantised": lambda: torch.quantize_per_tensor(torch.ones(2), 0.1, 0, torch.qint8),
}


# Torch warns that it may not keep such tensors.
@pytest.mark.filterwarnings("ignore::UserWarning", "ignore::DeprecationWarning")
@pytest.mark.parametrize("kind", SPECIAL)
def test_tensors_of_special_kinds_become_their_names(tmp_path, kind):
    found = read_torch_file(save(tmp_path / "a.pt", {"a": SPECIAL[kind](), "b": 1}, as_zip=True))
    assert isinstance(found["a"], Opaque)
    assert found["b"] == 1


# Nothing is run


class Runs:
    """Pickles as a call of a function."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


ATTACKS = {
    "os.system": lambda file: Runs(os.system, f"touch {file}"),
    "exec": lambda file: Runs(exec, f"import pathlib; pathlib.Path({str(file)!r}).touch()"),
    "method": lambda file: Runs(Path.touch, file),
}


@FORMS
@pytest.mark.parametrize("attack", ATTACKS.values(), ids=ATTACKS)
def test_nothing_in_a_file_is_run(tmp_path, as_zip, attack):
    proof = tmp_path / NEVER_RUN
    path = save(tmp_path / "bad", {"x": attack(proof), "y": 1}, as_zip)
    found = read_torch_file(path)
    assert isinstance(found["x"], Opaque)
    assert found["y"] == 1
    assert not proof.exists()
    torch.load(path, weights_only=False)
    assert proof.exists(), "the attack would not have worked"


def test_an_archive_behind_a_pickle_is_not_looked_at(tmp_path):
    good = save(tmp_path / "good", {"x": 1}, as_zip=True).read_bytes()
    bad = save(tmp_path / "bad", {"x": 2}, as_zip=False)
    bad.write_bytes(bad.read_bytes() + good)
    assert read_torch_file(bad) == {"x": 2}


# Time and memory are bounded by the size of the file

TUPLES = b")" + 90 * b"q\x00h\x00\x86"
"""A tuple of twice the same tuple, ninety deep: its hash would take forever."""
STORAGE = (
    b"(X\x07\x00\x00\x00storagectorch\nFloatStorage\nX\x01\x00\x00\x000X\x03\x00\x00\x00cpu%st"
)
REBUILD = b"ctorch._utils\n_rebuild_tensor_v2\n("


def number(n):
    return b"\x8a\x08" + struct.pack("<q", n)


def tensor(count, offset, size, stride):
    """Return the pickle of a tensor over a storage of so many float32, as `torch.save` has it."""
    shapes = (b"(" + b"".join(map(number, numbers)) + b"t" for numbers in (size, stride))
    body = STORAGE % number(count) + b"Q" + number(offset) + b"".join(shapes) + b"\x89}t"
    return REBUILD + body + b"R"


HOSTILE = {
    "bytearray of 6 GB": b"c__builtin__\nbytearray\n" + number(6 * 10**9) + b"\x85R",
    "bytes of 6 GB": b"c__builtin__\nbytes\n" + number(6 * 10**9) + b"\x85R",
    "nested tuples as a key": b"}" + TUPLES + b"Ns",
    "nested tuples as keys": b"}(" + TUPLES + b"Nu",
    "nested tuples as keys of pairs": b"ccollections\nOrderedDict\n]((" + TUPLES + b"Nte\x85R",
    "nested tuples in a set": b"c__builtin__\nset\n](" + TUPLES + b"e\x85R",
    "a counter": b"ccollections\nCounter\n}(" + TUPLES + b"Nu\x85R",
    "numbers that share a hash": b"}("
    + b"".join(b"\x8a\x0b" + ((2**61 - 1) * n).to_bytes(11, "little") + b"N" for n in range(20_000))
    + b"u",
    "a Size of many": b"ctorch\nSize\n](" + number(2**62) + b"e\x85R",
    "a large memo": b"Nr\xff\xff\xff\x7f",
}


@pytest.mark.parametrize("form", [archive, legacy])
@pytest.mark.parametrize("attack", HOSTILE.values(), ids=HOSTILE)
def test_what_is_not_needed_costs_nothing(tmp_path, form, attack):
    path = tmp_path / "bad"
    content = form(PROTOCOL + b"]" + attack + b"aX\x01\x00\x00\x00xa" + STOP)
    path.write_bytes(content)
    with bounded(len(content)):
        assert read_torch_file(path)[-1] == "x"


PROMISES = {
    "a storage of 40 GB": tensor(10**10, 0, [1], [1]),
    "a storage of negative size": tensor(-1, 0, [1], [1]),
    "a storage of 2⁶³": tensor(2**62, 0, [1], [1]),
    "one number 10¹⁸ times": tensor(1, 0, [10**9, 10**9], [0, 0]),
    "numbers beyond the storage": tensor(1, 10**9, [1], [1]),
    "numbers before the storage": tensor(1, -5, [1], [1]),
    "negative sizes": tensor(1, 0, [-1, -1], [1, 1]),
    "a million dimensions": tensor(1, 0, [1] * 10_000, [0] * 10_000),
    "fewer strides than sizes": tensor(1, 0, [1, 1], [1]),
    "text as a size": REBUILD + STORAGE % number(1) + b"QK\x00X\x01\x00\x00\x00aK\x01\x86\x89}tR",
    "a text of 4 GB": b"X\xff\xff\xff\xff",
    "bytes of 2⁶³": b"\x8e" + b"\xff" * 7 + b"\x7f",
    "a call of a number": b"K\x01)R",
    "a call of a tensor": tensor(1, 0, [1], [1]) + b")R",
    "items of a number": b"K\x01K\x01K\x01s",
    "values of a number": b"K\x01K\x01a",
    "an extension": b"\x82\x01",
    "an instance": b"(ios\nsystem\n",
    "too many operations": b"N" * MAX_OPERATIONS,
}


@pytest.mark.parametrize("form", [archive, legacy])
@pytest.mark.parametrize("attack", PROMISES.values(), ids=PROMISES)
def test_promises_that_a_file_cannot_keep_are_refused(tmp_path, form, attack):
    content = form(PROTOCOL + attack + STOP, **({"data/0": bytes(4)} if form is archive else {}))
    start = time.perf_counter()
    refused(tmp_path / "bad", content)
    assert time.perf_counter() - start < 20


@pytest.mark.parametrize(
    ("keys", "after"),
    [
        (b"].", b""),
        (b"](X\x01\x00\x00\x000e.", b""),
        (b"](X\x01\x00\x00\x000e.", struct.pack("<q", 1) + bytes(3)),
        (b"](X\x01\x00\x00\x000e.", struct.pack("<q", 2**62) + bytes(8)),
        (b"](X\x01\x00\x00\x000e.", struct.pack("<q", 1) + bytes(4)),
        (b"](X\x01\x00\x00\x001e.", struct.pack("<q", 2) + bytes(8)),
        (b"](" + TUPLES + b"e.", b""),
        (b"K\x01.", b""),
    ],
)
def test_legacy_storages_that_are_not_there(tmp_path, keys, after):
    pickled = PROTOCOL + tensor(2, 0, [2], [1]) + STOP
    refused(tmp_path / "bad", legacy(pickled, keys) + after)


def test_the_legacy_form_of_these_tests_is_one(tmp_path):
    pickled = PROTOCOL + tensor(2, 0, [2], [1]) + STOP
    numbers = struct.pack("<q2f", 2, 1.5, 2.5)
    (tmp_path / "a").write_bytes(legacy(pickled, b"](X\x01\x00\x00\x000e.") + numbers)
    assert read_torch_file(tmp_path / "a").tolist() == [1.5, 2.5]
    (tmp_path / "a").write_bytes(archive(pickled, **{"data/0": numbers[8:]}))
    assert read_torch_file(tmp_path / "a").tolist() == [1.5, 2.5]


def test_archives_that_hold_less_than_they_unpack_to(tmp_path):
    for method in (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", method) as file:
            file.writestr("a/data.pkl", bytes(50 << 20))
        assert "more than it holds" in refused(tmp_path / "bad", stream.getvalue())


# Damage


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04", b"x" * 5000, b"\x80\x02." * 4, pickle.dumps({"a": 1})]
)
def test_rubbish_is_refused(tmp_path, content):
    refused(tmp_path / "bad", content)


def test_what_is_no_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for name, says in (("none", "no such file"), ("", "directory"), ("pipe", "neither a file")):
        with pytest.raises(WeightsError, match=says):
            read_torch_file(tmp_path / name)
