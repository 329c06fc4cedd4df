# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""The digest of the tensors of a weights file."""

import os
from dataclasses import replace

import numpy as np
from calls import calls_of
from rewritten_weights import rewritten
from scans import refused
from shallow_network import shallow, weights  # noqa: F401

from salsanext_cli.commands.stages.models import describe_weights
from salsanext_cli.core.errors import WeightsError
from salsanext_cli.io.weights import tensor_digest
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import read_weights, save_with_card


def test_a_changed_byte_of_a_tensor_is_noticed(weights, tmp_path):
    """The lowest byte of a number changes it by less than any check of values could see."""
    content, path = weights.read_bytes(), tmp_path / "w.safetensors"
    start = 8 + int.from_bytes(content[:8], "little")
    draw = np.random.default_rng(1)
    for place in (start, len(content) - 1, *draw.integers(start, len(content), 6).tolist()):
        damaged = bytearray(content)
        damaged[place] ^= 1
        path.write_bytes(damaged)
        for read in (read_weights, describe_weights, lambda path: copied(path, tmp_path / "c")):
            refused(WeightsError, path, read, path)
    path.write_bytes(content)
    read_weights(path)
    copied(path, tmp_path / "c.safetensors")


def copied(source, target):
    """Write the tensors of a weights file with the same card."""
    save_with_card(source, target, read_card(source))


def test_the_digest_is_of_the_tensors_only(weights, tmp_path):
    """Names count: two tensors of one shape that change places are other tensors."""
    stored = read_card(weights).tensors_sha256
    assert describe_weights(weights).to_dict()["tensors_sha256"] == stored
    tuned, path = tmp_path / "tuned.safetensors", tmp_path / "w.safetensors"
    save_with_card(weights, tuned, replace(read_card(weights), temperature=1.5))
    assert read_card(tuned).tensors_sha256 == stored
    assert tuned.read_bytes() != weights.read_bytes()

    def swap(metadata, tensors):
        metadata["tensors_sha256"] = stored
        tensors.update({a: tensors[b], b: tensors[a]})

    a, b = (f"block1.stack.fuse.2.{name}" for name in ("weight", "bias"))
    caught = refused(WeightsError, path, read_weights, rewritten(weights, path, swap))
    assert "SHA-256" in caught.value.problem


def test_a_file_is_hashed_once_as_long_as_it_stays(weights, tmp_path):
    path = tmp_path / "w.safetensors"
    path.write_bytes(weights.read_bytes())
    with calls_of(tensor_digest._digest) as digests:
        for _ in range(3):
            read_weights(path)
        assert len(digests) == 1
        os.utime(path, ns=(0, 0))
        read_weights(path)
    assert len(digests) == 2


def test_files_without_a_digest_are_read(weights, tmp_path):
    path = rewritten(weights, tmp_path / "w.safetensors", lambda *_: None)
    assert describe_weights(path).to_dict()["tensors_sha256"] is None
    read_weights(path)
