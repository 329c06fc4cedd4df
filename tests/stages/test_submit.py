# SPDX-License-Identifier: MIT
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scans import make_scan, refused, write_bin

from salsanext_cli import label_space, write_labels
from salsanext_cli.errors import LabelError, OutputError
from salsanext_cli.results.paths import output_path
from salsanext_cli.stages import submit as module
from salsanext_cli.stages.submit import SCANS_OF_TEST, submit

SPACE = label_space()
COUNTS = dict.fromkeys(SCANS_OF_TEST, 1) | {"11": 3, "21": 2}
POINTS = 7


class Folders:
    """A data set of the test split, in small, and an output folder with its predictions."""

    def __init__(self, folder):
        self.data, self.out, self.zip = folder / "data", folder / "out", folder / "made/test.zip"

    def scan(self, sequence, stem):
        return self.data / "sequences" / sequence / "velodyne" / f"{stem}.bin"

    def label(self, sequence, stem):
        return output_path(self.out, sequence, "predictions", stem)

    def fill(self):
        for sequence, count in COUNTS.items():
            for number in range(count):
                stem = f"{number:06d}"
                write_bin(self.scan(sequence, stem), make_scan(POINTS))
                train = np.random.default_rng(number).integers(0, SPACE.class_count, POINTS)
                write_labels(self.label(sequence, stem), SPACE.to_raw(train))

    def submit(self, *, with_data=True, **options):
        return submit(self.out, self.zip, dataset=self.data if with_data else None, **options)


@pytest.fixture
def folders(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "SCANS_OF_TEST", COUNTS)
    monkeypatch.chdir(tmp_path)
    made = Folders(tmp_path)
    made.fill()
    return made


def test_the_known_counts_are_those_of_the_benchmark():
    assert sum(SCANS_OF_TEST.values()) == 20_351
    assert tuple(SCANS_OF_TEST) == SPACE.splits["test"]


@pytest.mark.parametrize("with_data", [True, False])
def test_the_file_is_what_the_benchmark_wants(folders, with_data, caplog):
    write_labels(folders.label("08", "000000"), np.full(3, 10))
    steps = []
    made = folders.submit(with_data=with_data, progress=lambda *step: steps.append(step))
    assert made == module.Submission(14, with_data, ())
    assert steps == [(number, 28) for number in range(1, 29)]
    assert ("sequence 11, 12, 13 and 8 more" in caplog.text) != with_data
    with zipfile.ZipFile(folders.zip) as packed:
        assert packed.testzip() is None
        names = packed.namelist()
        folders_of = ["sequences/"]
        for sequence in COUNTS:
            folders_of += [f"sequences/{sequence}/", f"sequences/{sequence}/predictions/"]
        assert [name for name in names if name.endswith("/")] == folders_of
        assert len(names) == len(set(names)) == len(folders_of) + 14
        for name in set(names) - {*folders_of}:
            assert packed.read(name) == (folders.out / name).read_bytes()
            assert names.index(name) > names.index(name.rpartition("/")[0] + "/")


def test_equal_predictions_give_equal_bytes(folders):
    text = folders.data / "me.txt"
    text.write_text("method: mine\n")
    folders.submit(description=text)
    first = folders.zip.read_bytes()
    for path in folders.out.rglob("*.label"):
        path.touch()
        path.chmod(0o600)
    folders.submit(description=text, overwrite=True)
    assert folders.zip.read_bytes() == first
    with zipfile.ZipFile(folders.zip) as packed:
        assert packed.read("description.txt") == b"method: mine\n"


def test_everything_that_is_wrong_is_listed_and_nothing_written(folders):
    folders.label("11", "000001").unlink()
    folders.scan("11", "000001").unlink()
    folders.label("11", "000002").write_bytes(b"12345")
    folders.label("12", "000000").unlink()
    write_labels(folders.label("13", "000000"), np.full(POINTS + 1, 40))
    write_labels(folders.label("14", "000000"), np.array([2, 3, 40, 40, 252, 258, 10]))
    write_labels(folders.label("15", "000000"), np.full(POINTS, 252 | 7 << 16))
    write_labels(folders.label("16", "000000"), np.full(POINTS, 10 | 7 << 16))
    # `eval` reads these labels, the benchmark does not.
    labels = np.full(POINTS + 1, 40)
    write_bin(folders.scan("17", "000000"), make_scan(len(labels)))
    folders.label("17", "000000").write_bytes(labels.astype("<u2").tobytes())
    made = folders.submit()
    assert [(p.code, p.sequence, p.scans) for p in made.problems] == [
        ("missing", "11", 1),
        ("unreadable", "11", 1),
        ("missing", "12", 1),
        ("length", "13", 1),
        ("unknown-id", "14", 1),
        ("moving", "14", 1),
        ("moving", "15", 1),
        ("length", "17", 1),
    ]
    missing, truncated, _, length, unknown, moving, _, short = made.problems
    assert "1 of 3 predictions are missing: 000001" in missing.message
    assert "1 of their scans" in missing.hint
    assert str(folders.label("11", "000002")) in truncated.message
    assert "8 labels (expected 7" in length.message
    assert "2, 3" in unknown.message
    assert "252 moving-car, 258 moving-truck" in moving.message
    assert "2 bytes per label" in short.message
    assert not folders.zip.exists()
    assert list(folders.zip.parent.iterdir()) == []


def test_an_incomplete_data_set_is_noticed(folders):
    """All available scans are predicted, so the scans alone would not show it."""
    for path in (folders.scan("21", "000001"), folders.label("21", "000001")):
        path.unlink()
    for with_data in (True, False):
        (problem,) = folders.submit(with_data=with_data).problems
        assert (problem.code, problem.sequence, problem.scans) == ("missing", "21", 1)
        assert ("their scans" in problem.hint) == with_data


def test_nothing_is_replaced_unasked(folders):
    folders.zip.parent.mkdir()
    folders.zip.write_text("mine")
    with refused(OutputError, folders.zip):
        folders.submit()
    folders.label("11", "000001").unlink()
    assert folders.submit(overwrite=True).problems
    assert folders.zip.read_text() == "mine"
    folders.zip = folders.zip.with_suffix(".tar")
    with refused(OutputError, folders.zip):
        folders.submit()


def test_another_label_space_needs_the_scans_of_its_test_split(folders):
    space = replace(SPACE, splits={**SPACE.splits, "test": ("11", "99")})
    made = folders.submit(space=space)
    (problem,) = made.problems
    assert (problem.code, problem.sequence, problem.scans) == ("missing", "99", 0)
    folders.label("11", "000002").unlink()
    only = replace(space, splits={"test": ("11",)})
    (problem,) = folders.submit(space=only).problems
    assert "1 of 3 predictions are missing: 000002" in problem.message
    assert folders.submit(space=only, with_data=False).scans == 2


def test_a_label_space_may_group_the_raw_ids_of_semantic_kitti(folders):
    """Only SemanticKITTI's test split must be in all its classes."""
    mine = replace(label_space("coarse"), name="mine", splits={"test": ("11",)})
    for with_data in (True, False):
        made = folders.submit(with_data=with_data, space=mine, overwrite=True)
        assert (made.scans, made.problems) == (3, ())
    official = replace(mine, splits=SPACE.splits)
    for space in (official, replace(mine, splits={})):
        with refused(LabelError, folders.out):
            folders.submit(space=space, overwrite=True)
    (folders.data / "labels.yaml").write_text(yaml.safe_dump(SPACE.to_dict()))
    with refused(LabelError, folders.out):
        folders.submit(space=mine, overwrite=True)
