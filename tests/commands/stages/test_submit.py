# SPDX-License-Identifier: MIT
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import yaml
from other_program import require_kept
from scans import make_scan, refused, write_bin

from salsanext_cli import label_space, write_labels
from salsanext_cli.commands.jobs.submission_checks import ProblemKind
from salsanext_cli.commands.stages import submit as module
from salsanext_cli.commands.stages.submit import SCANS_OF_TEST, Submission, submit
from salsanext_cli.core.errors import FormatError, LabelError, OutputError
from salsanext_cli.runs.results.output_paths import output_path

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
    assert made == Submission(scans=14, lengths_checked=with_data)
    assert steps == [(number, 28) for number in range(1, 29)]
    assert ("14 scans: 11/000000, 11/000001, 11/000002 and 11 more" in caplog.text) != with_data
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


def test_a_scan_that_is_not_there_is_not_checked(folders, caplog):
    folders.scan("11", "000001").unlink()
    made = folders.submit()
    assert made == Submission(scans=14, lengths_checked=False)
    assert "1 scan: 11/000001" in caplog.text


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


def test_a_file_that_was_written_meanwhile_is_kept(folders):
    require_kept(module, folders.zip, lambda overwrite: folders.submit(overwrite=overwrite))


def problems_by_subject(folders, **options):
    """Return the problems of predictions that are not packed, with their cases."""
    before = folders.zip.read_bytes() if folders.zip.exists() else None
    made = folders.submit(**options)
    assert not made.is_packed
    assert (folders.zip.read_bytes() if folders.zip.exists() else None) == before
    return {case.subject: (problem, case) for problem in made.problems for case in problem.cases}


def test_missing_predictions_are_one_problem(folders):
    for stem in ("000000", "000002"):
        folders.label("11", stem).unlink()
    folders.scan("11", "000000").unlink()
    ((subject, (_, case)),) = problems_by_subject(folders).items()
    assert (subject, case.code) == ("sequence 11", "no-input")
    assert "2 of 3 predictions: 000000, 000002" in case.problem
    assert "lacks 1 scan of it" in case.problem


def test_all_problems_are_listed_at_once(folders):
    folders.label("11", "000001").unlink()
    folders.label("13", "000000").unlink()
    folders.label("14", "000000").write_bytes(b"12345")
    for sequence, unknown in (("15", 2), ("16", 3), ("17", 4), ("18", 2)):
        several = np.array([unknown, 252, 40, 10, 0, 0, 0], "<u2")
        folders.label(sequence, "000000").write_bytes(several.tobytes())
    write_labels(folders.label("19", "000000"), np.full(POINTS + 2, 40))
    problems = {problem.kind: problem for problem in folders.submit().problems}
    subjects = {
        kind: [case.subject for case in problem.cases] for kind, problem in problems.items()
    }
    four = [str(folders.label(sequence, "000000")) for sequence in ("15", "16", "17", "18")]
    assert subjects == {
        ProblemKind.MISSING: ["sequence 11", "sequence 13"],
        ProblemKind.UNREADABLE: [str(folders.label("14", "000000"))],
        ProblemKind.WIDTH: four,
        ProblemKind.UNKNOWN: four,
        ProblemKind.MOVING: four,
        ProblemKind.COUNT: [str(folders.label("19", "000000"))],
    }
    unknown_ids = problems[ProblemKind.UNKNOWN]
    first, *examples = unknown_ids.text.splitlines()
    assert first == "4 cases: unknown ids"
    assert examples == [
        f"  {four[0]}: has unknown ids 2",
        f"  {four[1]}: has unknown ids 3",
        f"  {four[2]}: has unknown ids 4",
        f"hint: {unknown_ids.cases[0].hint}",
        "  and 1 more",
    ]


def test_every_incomplete_sequence_is_listed_with_its_remedy(folders):
    folders.scan("11", "000002").unlink()
    for sequence in COUNTS:
        folders.label(sequence, f"{COUNTS[sequence] - 1:06d}").unlink()
    (problem,) = folders.submit().problems
    first, *lines = problem.text.splitlines()
    assert first == f"{len(COUNTS)} cases: predictions are missing"
    assert [line.split(":")[0] for line in lines if not line.startswith("hint: ")] == [
        f"  sequence {sequence}" for sequence in sorted(COUNTS)
    ]
    # The first sequence lacks a scan, too.
    assert ["complete the data set" in line for line in (lines[1], lines[-1])] == [True, False]


def test_predictions_of_other_scans_are_named_and_not_packed(folders, caplog):
    write_labels(folders.label("11", "000777"), np.full(POINTS, 40))
    made = folders.submit()
    assert made.is_packed
    assert "1 prediction of scans that the benchmark does not have: 11/000777" in caplog.text
    with zipfile.ZipFile(folders.zip) as packed:
        assert not any("000777" in name for name in packed.namelist())


@pytest.mark.parametrize(
    ("content", "kind", "problem"),
    [
        (b"12345", FormatError, "has 5 bytes"),
        (np.full(POINTS + 1, 40, "<u4"), LabelError, "has 8 labels"),
        # `eval` reads these labels, the benchmark does not.
        (np.full(POINTS, 40, "<u2"), LabelError, "2 bytes per label"),
        (np.array([2, 3, 40, 10, 10, 10, 0], "<u4"), LabelError, "unknown ids 2, 3"),
        (np.full(POINTS, 252 | 7 << 16, "<u4"), LabelError, "classes, 252 moving-car"),
    ],
)
def test_a_wrong_file_is_a_problem_and_nothing_written(folders, content, kind, problem):
    """The last file is wrong, since all are checked before the first is written."""
    write_labels(folders.label("16", "000000"), np.full(POINTS, 10 | 7 << 16))
    path = folders.label("21", "000001")
    path.write_bytes(bytes(content))
    ((subject, (found, case)),) = problems_by_subject(folders).items()
    assert (subject, case.code) == (str(path), kind.code)
    assert problem in case.problem
    assert found.text.startswith(f"{path}: ")
    assert not folders.zip.parent.exists() or list(folders.zip.parent.iterdir()) == []


def test_an_incomplete_data_set_is_noticed(folders):
    """All available scans are predicted, so the scans alone would not show it."""
    for path in (folders.scan("21", "000001"), folders.label("21", "000001")):
        path.unlink()
    for with_data in (True, False):
        (problem,) = folders.submit(with_data=with_data).problems
        assert [case.subject for case in problem.cases] == ["sequence 21"]
        assert ("complete the data set" in problem.cases[0].hint) == with_data


def test_nothing_is_replaced_unasked(folders):
    folders.zip.parent.mkdir()
    folders.zip.write_text("mine")
    with refused(OutputError, folders.zip):
        folders.submit()
    folders.label("11", "000001").unlink()
    assert list(problems_by_subject(folders, overwrite=True)) == ["sequence 11"]
    assert folders.zip.read_text() == "mine"
    folders.zip = folders.zip.with_suffix(".tar")
    with refused(OutputError, folders.zip):
        folders.submit()


def test_another_label_space_needs_the_scans_of_its_test_split(folders):
    space = replace(SPACE, splits={**SPACE.splits, "test": ("11", "99")})
    assert list(problems_by_subject(folders, space=space)) == ["sequence 99"]
    folders.label("11", "000002").unlink()
    only = replace(space, splits={"test": ("11",)})
    (problem,) = folders.submit(space=only).problems
    assert "1 of 3 predictions: 000002" in problem.cases[0].problem
    assert folders.submit(space=only, with_data=False).scans == 2


def test_a_label_space_may_group_the_raw_ids_of_semantic_kitti(folders):
    """Only SemanticKITTI's test split must be in all its classes."""
    mine = replace(label_space("coarse"), name="mine", splits={"test": ("11",)})
    for with_data in (True, False):
        made = folders.submit(with_data=with_data, space=mine, overwrite=True)
        assert made.scans == 3
    official = replace(mine, splits=SPACE.splits)
    for space in (official, replace(mine, splits={})):
        with refused(LabelError, folders.out):
            folders.submit(space=space, overwrite=True)
    (folders.data / "labels.yaml").write_text(yaml.safe_dump(SPACE.to_dict()))
    with refused(LabelError, folders.out):
        folders.submit(space=mine, overwrite=True)
