# SPDX-License-Identifier: MIT
"""The data sets that benchmarks/default_weights.py makes of scans that are there."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from scans import write_sequence

from salsanext_cli import label_space
from salsanext_cli.results.selection import data_set_label_space
from salsanext_cli.training.data.sources import labelled_split

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def names(root: Path, split: str) -> list[str]:
    _, files = labelled_split(root, None, split)
    assert all(file.label_path.is_file() for file in files)
    return [f"{file.sequence}/{file.stem}" for file in files]


def test_streets_are_validated_with_real_scans_that_nothing_is_trained_on(tmp_path):
    script = runpy.run_path(str(BENCHMARKS / "default_weights.py"))
    source, real, streets = (tmp_path / name for name in ("source", "pandaset", "streets"))
    for sequence, count in (("001", 2), ("002", 12)):
        write_sequence(source / f"sequences/{sequence}", [f"{i:02}" for i in range(count)], count=9)
    for _ in range(2):
        script["link_pandaset"](source, real)
    assert names(real, "train") == ["001/001-00", "001/001-01", "002/002-00", "002/002-01"]
    held_out = [f"002-{i:02}" for i in range(2, 12)]
    assert names(real, "valid") == [f"held-out/{stem}" for stem in held_out]

    for sequence, stems in (("00", "ab"), ("08", "abcdefgh")):
        write_sequence(streets / "sequences" / sequence, stems, count=9)
    script["link_streets"](streets, real, tmp_path / "validated")
    assert names(tmp_path / "validated", "train") == ["00/00-a", "00/00-b"]
    assert names(tmp_path / "validated", "valid") == [
        *(f"valid-pandaset/held-out-{stem}" for stem in held_out),
        *("valid-streets/08-a", "valid-streets/08-e"),
    ]
    # What the held-out scans are labelled with means the same as in PandaSet's label space.
    both, own = map(data_set_label_space, (tmp_path / "validated", real))
    ids = np.array(list(own.learning_map), np.uint32)
    np.testing.assert_array_equal(both.to_train(ids), own.to_train(ids))


@pytest.mark.parametrize("name", ["pandaset", "aachen"])
def test_the_label_spaces_have_the_classes_of_semantickitti(name):
    space = label_space(BENCHMARKS / f"{name}.yaml")
    assert space.fits(label_space())
    for i, several in space.alternatives.items():
        assert space.learning_map[i] in several
