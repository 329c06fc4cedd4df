# SPDX-License-Identifier: MIT
"""Hostile files of strangers: label spaces and weights."""

import json
import struct

import pytest
from fuzzing.limits import bounded
from scans import SMALL

from salsanext_cli import label_space
from salsanext_cli.core.errors import UsageError, WeightsError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.io.weights.weights import read_weights

SPACE = "labels: {0: a, 1: b}\nlearning_map: {0: 0, 1: 1}\nlearning_map_inv: {0: 0, 1: 1}\n"


def refused(path, content, read, error):
    """Fail unless a reader raises a short error, in bounded time and memory."""
    data = content if isinstance(content, bytes) else content.encode()
    path.write_bytes(data)
    with bounded(len(data)), pytest.raises(error) as caught:
        read(path)
    assert path.name in caught.value.subject
    assert "\n" not in caught.value.headline
    assert len(str(caught.value)) < 2000


LAUGHS = "a: &a [x, x]\n" + "".join(
    f"{new}: &{new} [*{old}, *{old}]\n" for old, new in zip("abcdefghij", "bcdefghijk", strict=True)
)
MERGES = "a: &a {x: 1}\n" + "".join(
    f"{new}: &{new}\n  <<: [{', '.join([f'*{old}'] * 10)}]\n"
    for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


SPACES = (
    *("", "text", "- 1\n- 2\n", "labels: {", "labels: {0: a}\n", "a: !!a/x\n", b"\xff\xfe"),
    *(LAUGHS, MERGES, "&a [*a]", "a: &a b\nc: *a"),
    *("[" * 20_000, "{a: " * 20_000, "- " * 20_000, "a: !!python/object/apply:os.system [id]"),
    *("2001-99-99", "!!timestamp x", "!!int ''", "!!bool x", "!!float x", "!!int -"),
    "9" * 5000,
    *("\0", "a: \ud800".encode("utf-8", "surrogatepass").decode("latin-1"), "a: 1\n" * 100_000),
    SPACE + "split: {train: 3}",
    SPACE.replace("0: a", ".inf: a"),
    SPACE.replace("0: a", f"0x{'f' * 6000}: a"),
    SPACE + "color_map: {0: 'long'}",
    SPACE + f"color_map: {{0: {[*range(50_000)]}}}",
    SPACE + f"split: {{train: {{{'x' * 9000}: 1}}}}",
)


@pytest.mark.parametrize("text", SPACES)
def test_label_spaces(tmp_path, text):
    refused(tmp_path / "labels.yaml", text, label_space, UsageError)


def metadata(**changes):
    card = WeightsCard({"name": "salsanext", "class_count": 20}, label_space(), SMALL)
    values = json.loads(card.to_metadata()["salsanext"]) | changes
    header = json.dumps({"__metadata__": {"salsanext": json.dumps(values)}}).encode()
    return struct.pack("<Q", len(header)) + header


DEEP = json.dumps({"__metadata__": {"salsanext": '{"a":' * 50_000}}).encode()


def test_safetensors(tmp_path):
    for data in (
        *(b"", b"\0" * 4, b"hello, world, this is no such file" * 9),
        *(struct.pack("<Q", size) + b"{}" for size in (2**63, 2**64 - 1, 2**40, 3)),
        struct.pack("<Q", len(DEEP)) + DEEP,
        metadata(architecture={"name": "salsanext", "class_count": 10**9}),
        metadata(architecture={"name": "salsanext", "class_count": -1}),
        metadata(architecture={"name": "salsanext", "class_count": 20, "dropout": "x" * 9000}),
        metadata(architecture={"name": "x" * 9000, "class_count": 20}),
        metadata(temperature=int("9" * 4000)),
        metadata(format="x" * 9000),
    ):
        refused(tmp_path / "w.safetensors", data, read_weights, WeightsError)
