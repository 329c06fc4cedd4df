# SPDX-License-Identifier: MIT
"""Paths of results lie in the output folder, and are found again."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.core.errors import OutputError
from salsanext_cli.runs.results.output_paths import find_outputs, output_path


def make(folder: Path, *names: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_bytes(b"")


@pytest.mark.parametrize("folder", ["predictions", "uncertainty/entropy", "ply/label"])
def test_outputs_are_at_their_paths(tmp_path: Path, folder: str) -> None:
    assert find_outputs(tmp_path, folder) == {}
    names = [("08", "b.c"), ("08", "a"), ("00 ä", "a")]
    for sequence, stem in names:
        path = output_path(tmp_path, sequence, folder, stem)
        make(path.parent, path.name, ".half.part", f".{path.name}", "other.txt")
    outputs = find_outputs(tmp_path, folder)
    assert list(outputs) == sorted(names)
    for (sequence, stem), path in outputs.items():
        assert path == output_path(tmp_path, sequence, folder, stem)
        assert path.is_file()


NAMES = st.sampled_from(["a", "", ".", "..", "../x", "/etc", "a/b", "a/../b", "a/", "x\0y"])
NAMES |= st.text()


@given(NAMES, NAMES)
def test_no_name_leads_out_of_the_output_folder(sequence: str, stem: str) -> None:
    try:
        path = output_path(Path("/out"), sequence, "range", stem)
    except OutputError:
        return
    assert path.parts == ("/", "out", "sequences", sequence, "range", f"{stem}.npy")
    assert not {"..", "\0"} & {*path.parts, *str(path)}
