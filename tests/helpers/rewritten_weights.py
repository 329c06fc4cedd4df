# SPDX-License-Identifier: MIT
"""Weights files with other content."""

import json

import safetensors.torch

from salsanext_cli.core.network.card import KEY


def rewritten(source, target, change):
    """Copy a weights file with changed metadata and tensors, which have no digest."""
    with safetensors.safe_open(source, framework="pt") as file:
        metadata = json.loads(file.metadata()[KEY])
    del metadata["tensors_sha256"]
    tensors = safetensors.torch.load_file(source)
    change(metadata, tensors)
    target.write_bytes(safetensors.torch.save(tensors, {KEY: json.dumps(metadata)}))
    return target
