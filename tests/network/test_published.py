# SPDX-License-Identifier: MIT
"""Checkpoints as the published code saves them, and files that only look like it."""

import argparse
import functools
import os
import pickle
import sys
import types
import zipfile
from collections import OrderedDict, defaultdict
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scans import lively

from salsanext_cli.errors import OutputError, UsageError, WeightsError
from salsanext_cli.network import published
from salsanext_cli.network.published import our_name, read_published
from salsanext_cli.network.salsanext import SalsaNext
from salsanext_cli.network.weights import load_tensors, read_card, read_weights, save_with_card
from salsanext_cli.sensors import sensor
from salsanext_cli.stages.import_weights import import_weights

FORMS = pytest.mark.parametrize("as_zip", [True, False], ids=["zip", "legacy"])


def published_names():
    """Return the published name of each of ours, by turning the tables round."""
    groups = [
        *(("downCntx" + n, f"context.{i}", published.CONTEXT_UNITS) for i, n in enumerate(" 23")),
        *((f"resBlock{n}", f"block{n}", published.RESIDUAL_UNITS) for n in range(1, 6)),
        *((f"upBlock{n}", f"up{n}.stack", published.UP_UNITS) for n in range(1, 5)),
    ]
    return {
        f"{ours}.{unit}": f"{theirs.strip()}.{key}"
        for theirs, ours, units in groups
        for key, unit in units.items()
    } | {"logits": "logits"}


@pytest.fixture(scope="module")
def module():
    return lively(SalsaNext(20))


@pytest.fixture(scope="module")
def state(module):
    """Return a state dictionary under published names, without prefix."""
    names = published_names()
    renamed = {}
    for key, tensor in module.state_dict().items():
        place, leaf = key.rsplit(".", 1)
        renamed[f"{names[place]}.{leaf}"] = tensor
    return renamed


FEW = {
    "logits.bias": torch.arange(3.0),
    "upBlock1.bn4.num_batches_tracked": torch.tensor(7),
    "downCntx2.conv1.weight": torch.ones(2, 2, 1, 1),
}
FEW_OURS = ("logits.bias", "up1.stack.fuse.2.num_batches_tracked", "context.1.shortcut.0.weight")


def assert_few(tensors):
    assert tuple(tensors) == FEW_OURS
    for read, written in zip(tensors.values(), FEW.values(), strict=True):
        assert torch.equal(read, written)
        assert read.dtype == written.dtype


@pytest.fixture
def vanishing_class():
    """Provide a scheduler-like class whose module is gone when the file is read."""
    source = types.ModuleType("common_of_somebody")
    exec(
        "class WarmupLR:\n"
        "    def __init__(self):\n"
        "        self.state = {'step': 3, 'lrs': [0.1]}\n",
        source.__dict__,
    )
    sys.modules["common_of_somebody"] = source
    yield source.WarmupLR
    sys.modules.pop("common_of_somebody", None)


def save(path, content, as_zip):
    torch.save(content, path, _use_new_zipfile_serialization=as_zip)
    return path


@FORMS
def test_a_whole_checkpoint(tmp_path, state, module, as_zip):
    path = save(tmp_path / "SalsaNext", {"epoch": 7, "state_dict": state}, as_zip)
    fresh = SalsaNext(20)
    load_tensors(fresh, read_published(path), path)
    for name, tensor in module.state_dict().items():
        assert torch.equal(fresh.state_dict()[name], tensor), name


@FORMS
@pytest.mark.parametrize("prefix", ["", "module."])
@pytest.mark.parametrize("wrapped", [True, False], ids=["wrapped", "bare"])
def test_prefix_wrapping_and_form_do_not_matter(tmp_path, as_zip, prefix, wrapped):
    tensors = OrderedDict((prefix + name, tensor) for name, tensor in FEW.items())
    content = {"epoch": 7, "state_dict": tensors, "info": {"best": 0.5}} if wrapped else tensors
    assert_few(read_published(save(tmp_path / "SalsaNext", content, as_zip)))


@FORMS
def test_a_scheduler_of_a_module_that_is_gone_is_passed_over(tmp_path, as_zip, vanishing_class):
    content = {
        "epoch": 1,
        "scheduler": vanishing_class(),
        "state_dict": {
            name: torch.nn.Parameter(t) if t.is_floating_point() else t for name, t in FEW.items()
        },
        "info": {"device": torch.device("cpu"), "set": {1, 2}, "best": np.float64(0.5)},
        "args": argparse.Namespace(epochs=150),
    }
    path = save(tmp_path / "SalsaNext", content, as_zip)
    del sys.modules["common_of_somebody"]
    assert_few(read_published(path))
    assert "common_of_somebody" not in sys.modules


@FORMS
def test_built_in_classes_inside_a_scheduler_are_passed_over(tmp_path, as_zip):
    """Pickles call them by the names of Python 2, such as `__builtin__.dict`."""
    scheduler = {"by": defaultdict(dict, {1: {}}), "kind": dict, "step": functools.partial(max, 1)}
    content = {"scheduler": scheduler, "state_dict": FEW}
    assert_few(read_published(save(tmp_path / "SalsaNext", content, as_zip)))


class Runs:
    """Pickles as a call of a function."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


def touch(path):
    open(path, "w").close()  # noqa: PTH123


@FORMS
@pytest.mark.parametrize(
    "attack",
    [
        lambda file: Runs(os.system, f"touch {file}"),
        lambda file: Runs(exec, f"open({str(file)!r}, 'w')"),
        lambda file: Runs(eval, f"open({str(file)!r}, 'w')"),
        lambda file: Runs(open, str(file), "w"),
        lambda file: Runs(touch, str(file)),
        lambda file: Runs(os.mkdir, str(file)),
    ],
    ids=["os.system", "exec", "eval", "open", "function", "mkdir"],
)
def test_nothing_in_the_file_is_run(tmp_path, as_zip, attack):
    proof = tmp_path / "proof"
    content = {"state_dict": FEW, "scheduler": attack(proof)}
    path = save(tmp_path / "SalsaNext", content, as_zip)
    try:
        read_published(path)
    except WeightsError as error:
        assert str(path) in str(error)  # noqa: PT017
    assert not proof.exists()


@FORMS
def test_the_attack_would_have_worked(tmp_path, as_zip):
    """Read without our restriction, the same file does what it says."""
    proof = tmp_path / "proof"
    path = save(tmp_path / "bad", {"x": Runs(os.mkdir, str(proof))}, as_zip)
    torch.load(path, weights_only=False)
    assert proof.exists()


@FORMS
def test_an_attack_in_place_of_the_tensors_is_refused(tmp_path, as_zip):
    proof = tmp_path / "proof"
    path = save(tmp_path / "bad", Runs(os.mkdir, str(proof)), as_zip)
    with pytest.raises(WeightsError, match=r"posix\.mkdir whose module posix is blocked"):
        read_published(path)
    assert not proof.exists()


@pytest.mark.parametrize("protocol", range(6))
def test_a_plain_pickle_that_runs_something_is_refused(tmp_path, protocol):
    proof = tmp_path / "proof"
    path = tmp_path / "bad"
    path.write_bytes(pickle.dumps(Runs(os.mkdir, str(proof)), protocol))
    with pytest.raises(WeightsError, match="bad"):
        read_published(path)
    assert not proof.exists()


def test_a_zip_behind_a_pickle_is_refused_or_harmless(tmp_path):
    """Both readers of the file must not disagree about what it is to an attacker's advantage."""
    proof = tmp_path / "proof"
    good = save(tmp_path / "good", {"state_dict": FEW}, as_zip=True).read_bytes()
    bad = save(tmp_path / "bad", {"x": Runs(os.mkdir, str(proof))}, as_zip=False)
    bad.write_bytes(bad.read_bytes() + good)
    with pytest.raises(WeightsError):
        read_published(bad)
    assert not proof.exists()


@FORMS
@pytest.mark.parametrize(
    "content",
    [
        {"state_dict": 3},
        {"state_dict": {"logits.weight": "text"}},
        {"model": {"x": torch.zeros(1)}},
        [torch.zeros(1)],
        torch.zeros(3),
        "text",
        {"state_dict": {"unheard.of.weight": torch.zeros(1)}},
        {"state_dict": {3: torch.zeros(1)}},
    ],
)
def test_files_that_are_no_checkpoints(tmp_path, content, as_zip):
    path = save(tmp_path / "SalsaNext", content, as_zip)
    with pytest.raises(WeightsError, match="SalsaNext"):
        read_published(path)


@pytest.mark.parametrize("content", [b"", b"\x80", b"PK\x03\x04", b"x" * 5000, b"\x80\x02." * 4])
def test_files_of_rubbish(tmp_path, content):
    (tmp_path / "SalsaNext").write_bytes(content)
    with pytest.raises(WeightsError, match="SalsaNext"):
        read_published(tmp_path / "SalsaNext")


def test_files_that_are_not_there(tmp_path):
    with pytest.raises(WeightsError, match="no such file"):
        read_published(tmp_path / "nothing")
    with pytest.raises(WeightsError, match="directory"):
        read_published(tmp_path)


@FORMS
@pytest.mark.parametrize("share", [0.0005, 0.1, 0.5, 0.99, 0.9999])
def test_truncated_checkpoints(tmp_path, state, share, as_zip):
    path = save(tmp_path / "SalsaNext", {"state_dict": state}, as_zip)
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])
    with pytest.raises(WeightsError, match="SalsaNext"):
        read_published(path)


@pytest.fixture(scope="module")
def little(tmp_path_factory):
    """Return the bytes of two little checkpoints, in both forms."""
    folder = tmp_path_factory.mktemp("little")
    content = {"state_dict": {"logits.bias": torch.arange(3.0)}, "info": {"a": [1, 2.5, "x", None]}}
    return [save(folder / "SalsaNext", content, as_zip).read_bytes() for as_zip in (True, False)]


@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_damaged_checkpoints_are_refused_or_harmless(little, tmp_path_factory, data):
    content = bytearray(data.draw(st.sampled_from(little)))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "damaged"
    path.write_bytes(content)
    try:
        tensors = read_published(path)
    except WeightsError as error:
        assert str(path) in str(error)  # noqa: PT017
    else:
        assert all(isinstance(tensor, torch.Tensor) for tensor in tensors.values())


@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_damaged_compressed_zip_is_refused(tmp_path, method):
    path = tmp_path / "SalsaNext"
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("SalsaNext/data.pkl", b"abc" * 1000)
    content = bytearray(path.read_bytes())
    start = content.index(b"data.pkl") + len(b"data.pkl")
    content[start : start + 20] = b"\xff" * 20
    path.write_bytes(content)
    with pytest.raises(WeightsError, match="SalsaNext"):
        read_published(path)


def test_names():
    assert our_name("upBlock1.bn4.bias") == "up1.stack.fuse.2.bias"
    assert our_name("downCntx.conv1.weight") == "context.0.shortcut.0.weight"
    assert our_name("downCntx3.bn2.running_var") == "context.2.dilated.2.running_var"
    for unknown in ("upBlock1.bn9.bias", "resBlock.conv1.weight", "logits.running_mean", ""):
        with pytest.raises(WeightsError, match="unknown tensor"):
            our_name(unknown, "file")


@pytest.mark.real
def test_the_published_file_is_imported(golden, tmp_path):
    target = tmp_path / "w.safetensors"
    import_weights(golden / "SalsaNext", target, half=True, dropout=0.1)
    module, card = read_weights(target)
    assert target.stat().st_size < 15e6
    assert card.sensor == sensor("hdl64")
    assert card.architecture == {"name": "salsanext", "class_count": 20, "dropout": 0.1}
    assert "SalsaNext" in card.description
    assert module.bottom.rate == 0.1


@pytest.fixture
def checkpoint(tmp_path, state):
    return save(tmp_path / "SalsaNext", {"state_dict": state}, as_zip=True)


def test_ours_are_stored_anew_in_half_the_size(weights, tmp_path):
    target = tmp_path / "half.safetensors"
    card = import_weights(weights, target, half=True, description="halved")
    assert card.description == "halved"
    assert target.stat().st_size < 0.51 * weights.stat().st_size
    assert read_weights(target)[1].sensor == card.sensor


def test_ours_keep_their_temperature(weights, tmp_path):
    tuned, target = tmp_path / "tuned.safetensors", tmp_path / "again.safetensors"
    save_with_card(weights, tuned, replace(read_card(weights), temperature=1.75))
    assert import_weights(tuned, target).temperature == 1.75
    assert read_card(target).temperature == 1.75


def test_a_target_that_exists_is_kept_unless_overwriting(checkpoint, tmp_path):
    target = tmp_path / "w.safetensors"
    target.write_bytes(b"precious")
    with pytest.raises(OutputError, match="exists"):
        import_weights(checkpoint, target)
    assert target.read_bytes() == b"precious"
    import_weights(checkpoint, target, overwrite=True)
    assert read_weights(target)


def test_a_target_needs_its_suffix(checkpoint, tmp_path):
    with pytest.raises(OutputError, match=r"suffix \.pt · expected \.safetensors"):
        import_weights(checkpoint, tmp_path / "w.pt")


def test_a_checkpoint_of_another_label_space_is_refused(tmp_path, state):
    cut = {k: v[:5] if k.startswith("logits") else v for k, v in state.items()}
    path = save(tmp_path / "SalsaNext", {"state_dict": cut}, as_zip=True)
    with pytest.raises(WeightsError, match="5 outputs · expected 20, one per class"):
        import_weights(path, tmp_path / "w.safetensors")


@pytest.mark.parametrize("bias", [None, torch.tensor(3.0)])
def test_a_checkpoint_without_usable_outputs_is_refused(tmp_path, state, bias):
    cut = {name: tensor for name, tensor in state.items() if name != "logits.bias"}
    cut |= {} if bias is None else {"logits.bias": bias}
    path = save(tmp_path / "SalsaNext", {"state_dict": cut}, as_zip=True)
    with pytest.raises(WeightsError, match="outputs"):
        import_weights(path, tmp_path / "w.safetensors")


@pytest.mark.parametrize("rate", [-1, 1, 7, float("nan")])
def test_a_dropout_rate_that_is_none(checkpoint, tmp_path, rate):
    with pytest.raises(UsageError, match="dropout"):
        import_weights(checkpoint, tmp_path / "w.safetensors", dropout=rate)
    assert not (tmp_path / "w.safetensors").exists()


def test_values_that_are_not_finite_are_refused(tmp_path, state):
    bad = state | {"logits.bias": torch.full((20,), torch.nan)}
    path = save(tmp_path / "SalsaNext", {"state_dict": bad}, as_zip=True)
    with pytest.raises(WeightsError, match=r"logits\.bias holds values that are not finite"):
        import_weights(path, tmp_path / "w.safetensors")
