# SPDX-License-Identifier: MIT
"""Digests of scans come back from a file of their own, or the record states that it is gone."""

import hashlib

import pytest
from scans import refused

from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.network.card import DIGITS, split_digests
from salsanext_cli.runs.results.digest_files import (
    digests_of_guarantee,
    names_files,
    recorded_scans,
    with_files,
    with_names,
    without_names,
)


def joined(count: int, seed: str) -> str:
    """Return digests of scans as the card of weights has them."""
    texts = (f"{seed} {number}" for number in range(count))
    return "".join(hashlib.sha256(text.encode()).hexdigest()[:DIGITS] for text in texts)


TRAINED_ON = joined(5, "trained on")
CHOSEN_ON = joined(3, "chosen on")
SETTINGS = {"weights": "abc", "trained_on": TRAINED_ON, "guarantee": {"digests": CHOSEN_ON}}


def test_digests_come_back_from_their_files(tmp_path):
    stored = with_files(SETTINGS, tmp_path)
    assert stored == with_names(SETTINGS)
    assert stored["weights"] == "abc"
    record = tmp_path / "predict.json"
    for name, text in (
        (stored["trained_on"], TRAINED_ON),
        (digests_of_guarantee(stored), CHOSEN_ON),
    ):
        assert recorded_scans(name, record).digests == {*split_digests(text)}
        # Records of early versions have the digests themselves.
        assert recorded_scans(text, record) == recorded_scans(name, record)


def test_files_are_written_once(tmp_path):
    stored = with_files(SETTINGS, tmp_path)
    times = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert with_files(SETTINGS, tmp_path) == with_files(stored, tmp_path) == stored
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == times
    assert len(times) == 2


def test_a_missing_file_is_stated_with_a_hint(tmp_path):
    name = str(with_names(SETTINGS)["trained_on"])
    scans = recorded_scans(name, tmp_path / "predict.json")
    assert (scans.digests, scans.missing) == (frozenset(), tmp_path / name)
    assert scans.hint
    assert not recorded_scans(TRAINED_ON, tmp_path / "predict.json").hint


def test_a_file_with_other_digests_is_refused(tmp_path):
    name = str(with_files(SETTINGS, tmp_path)["trained_on"])
    path = tmp_path / name
    path.write_bytes(path.read_bytes().splitlines(keepends=True)[0])
    refused(OutputError, path, recorded_scans, name, tmp_path / "predict.json")


@pytest.mark.parametrize("settings", [{}, {"trained_on": None}, {"guarantee": {"digests": ""}}])
def test_settings_without_digests_stay(settings, tmp_path):
    assert with_files(settings, tmp_path) == with_names(settings) == settings
    assert not [*tmp_path.iterdir()]
    assert not names_files(settings)


def test_settings_tell_whether_they_name_files():
    assert not names_files(SETTINGS)
    named = with_names(SETTINGS)
    assert names_files(named)
    assert without_names(named)["guarantee"] == {"digests": ""}
    assert without_names(SETTINGS) == SETTINGS
