# SPDX-License-Identifier: MIT
"""Labels inside of LAS scans, compared with those that `import-labels` writes."""

import re

import numpy as np
import pytest
from calls import calls_of
from las_files import write_las
from scans import SMALL, make_scan, refused, write_bin

from salsanext_cli import label_space, read_labels, read_scan, write_labels
from salsanext_cli.commands.stages.import_labels import import_labels
from salsanext_cli.core.errors import LabelError
from salsanext_cli.io.formats.survey.las_file import read_las_file
from salsanext_cli.runs.annotation.las_classification import (
    classified_scans,
    labels_source,
    read_scan_labels,
)
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.sources import read_labelled

pytest.importorskip("laspy")
pytest.importorskip("lazrs")
SPACE = label_space()
COARSE = label_space("coarse")
CODES = np.random.default_rng(0).choice([0, 1, 2, 3, 5, 7, 11, 74], 300).astype(np.uint8)


def classified(path, codes=CODES):
    return write_las(path, make_scan(300).points, classification=codes)


def test_they_are_those_that_import_labels_writes(tmp_path):
    folder = classified(tmp_path / "scans/a.laz").parent
    (scan,) = find_scans(folder)
    assert labels_source(scan) == scan.path
    raw = read_scan_labels(scan, COARSE, read_scan(scan.path))
    train = COARSE.to_train(raw)
    ground = COARSE.to_train(np.uint32([48]))[0]
    np.testing.assert_array_equal(train == 0, np.isin(CODES, (0, 1, 7)))
    np.testing.assert_array_equal(train == ground, np.isin(CODES, (2, 11)))
    assert import_labels(folder, folder, space=COARSE).failures == []
    np.testing.assert_array_equal(read_labels(scan.label_path), raw)


def test_codes_of_merged_classes_are_read_and_those_of_no_class_are_unlabelled(tmp_path):
    """A building is of the coarse class structure, and other-object (163) of none."""
    codes = np.uint8([6, 115, 163] * 100)
    (scan,) = find_scans(classified(tmp_path / "scans/a.las", codes).parent)
    for space, names in ((COARSE, ["structure"] * 2), (SPACE, ["building", "fence"])):
        train = space.to_train(read_scan_labels(scan, space, read_scan(scan.path)))
        assert [space.names[i] for i in train[:3].tolist()] == [*names, space.names[0]]


def test_files_are_read_once_for_a_list_and_once_for_a_sample(tmp_path):
    classified(tmp_path / "scans/a.laz")
    classified(tmp_path / "scans/b.laz")
    files = find_scans(tmp_path / "scans")
    with calls_of(read_las_file) as calls:
        for _ in range(2):
            assert classified_scans(files, COARSE) == files
        assert len(calls) == 2
        read_labelled(files[0], COARSE, SMALL)
    assert len(calls) == 3


def test_a_label_file_takes_precedence(tmp_path):
    (scan,) = find_scans(classified(tmp_path / "scans/a.las").parent)
    raw = np.full(300, 50, np.uint32)
    write_labels(scan.label_path, raw)
    assert labels_source(scan) == scan.label_path
    np.testing.assert_array_equal(read_scan_labels(scan, SPACE, read_scan(scan.path)), raw)
    refused(LabelError, scan.label_path, read_scan_labels, scan, SPACE, make_scan(299))


def test_only_las_scans_with_a_class_are_classified(tmp_path):
    classified(tmp_path / "scans/a.las")
    classified(tmp_path / "scans/b.las", np.uint8([0, 1, 7] * 100))
    write_bin(tmp_path / "bin/a.bin", make_scan(300))
    files = find_scans(tmp_path / "scans") + find_scans(tmp_path / "bin")
    assert [file.stem for file in classified_scans(files, COARSE)] == ["a"]
    assert labels_source(files[-1]) == files[-1].label_path


@pytest.mark.parametrize(("space", "code"), [(SPACE, 2), (COARSE, 9)])
def test_the_hint_has_a_command_that_decides_about_codes_without_a_single_class(
    tmp_path, space, code
):
    """Ground may be one of three classes, and water is none of the coarse ones."""
    codes = np.where(CODES == 2, code, CODES).astype(np.uint8)
    folder = classified(tmp_path / "scans/a.las", codes).parent
    (scan,) = find_scans(folder)
    caught = refused(LabelError, scan.path, read_scan_labels, scan, space, read_scan(scan.path))
    assert f"{code} ({(codes == code).sum()} points)" in caught.value.problem
    meaning = "no class of coarse" if space is COARSE else "several classes of semantic-kitti"
    assert meaning in caught.value.problem
    assert ('space="coarse"' in caught.value.hint) == (space is COARSE)
    assert f"salsanext import-labels {folder} {folder}" in caught.value.hint
    (entries,) = re.findall(r"such as (\{.*\})", caught.value.hint)
    mapped = tmp_path / "map.yaml"
    mapped.write_text(entries)
    assert import_labels(folder, folder, ids=mapped, space=space).failures == []
    (scan,) = find_scans(folder)
    assert labels_source(scan) == scan.label_path
    labels = read_scan_labels(scan, space, read_scan(scan.path))
    assert {*labels[codes == code].tolist()} < ({48, 49, 72} if space is SPACE else {0, 1})
    np.testing.assert_array_equal(labels[codes == 74], 10)
