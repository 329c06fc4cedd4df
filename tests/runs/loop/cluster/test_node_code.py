# SPDX-License-Identifier: MIT
"""What a node lacks is named, with the path; the code of the check imports no package."""

import ast
import os
import pickle
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from worker_tasks import Write, scans_of

from salsanext_cli.core import plug_ins, wording
from salsanext_cli.core.engines import device
from salsanext_cli.core.engines.registry import library_packages
from salsanext_cli.core.errors import FormatError, MissingDependency
from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.core.plug_ins import plug_in_packages
from salsanext_cli.io.files.atomic import GUARD, MARK
from salsanext_cli.runs.loop.cluster import node_code
from salsanext_cli.runs.loop.cluster.bug import Bug
from salsanext_cli.runs.loop.cluster.node_code import (
    NodeRequirements,
    NodeWorker,
    Probe,
    ReadableFile,
    SharedFolder,
    installed_versions,
    missing_module,
    node_problem,
    version_problem,
)
from salsanext_cli.runs.loop.cluster.work import Work
from salsanext_cli.runs.loop.pool import WorkerProcess
from salsanext_cli.version import __version__


@pytest.fixture
def required(tmp_path):
    """Return what this machine has: a scan, and a folder for results."""
    scan = tmp_path / "scan.bin"
    scan.write_bytes(b"1234")
    return NodeRequirements(
        versions=installed_versions([*library_packages(), *plug_in_packages()]),
        files=(ReadableFile(path=str(scan), size=4), ReadableFile(path=str(tmp_path), size=None)),
        folders=(SharedFolder(path=str(tmp_path), is_written=True),),
    )


def test_only_the_standard_library_is_imported_before_a_function_runs():
    tree = ast.parse(Path(node_code.__file__).read_text("utf-8"))
    imports = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    names = {getattr(node, "module", None) or node.names[0].name for node in imports}
    assert len(names) > 5
    assert {name.partition(".")[0] for name in names} <= sys.stdlib_module_names


def test_a_node_like_this_one_lacks_nothing(required, tmp_path):
    assert node_problem(required) is None
    assert [path.name for path in tmp_path.iterdir()] == ["scan.bin"]


def test_versions_are_those_of_the_packages():
    versions = installed_versions(library_packages())
    assert versions.keys() == {"salsanext", *library_packages()}
    assert versions["salsanext"] == __version__
    assert versions["torch"] == sys.modules["torch"].__version__.partition("+")[0]


def test_another_version_is_named():
    expected = {"salsanext": "2.0", "torch": "2.13.0"}
    assert version_problem(expected, dict(expected)) == ""
    for installed, words in (("1.0", "has salsanext 1.0"), ("", "lacks salsanext")):
        assert words in version_problem(expected, {**expected, "salsanext": installed})


def test_plug_ins_that_only_a_node_has_are_named(required, monkeypatch):
    here = plug_in_packages()
    monkeypatch.setattr(plug_ins, "plug_in_packages", lambda: [*here, "radian-lidar"])
    problem = node_problem(required)
    assert "radian-lidar" in problem.text
    assert problem.hint == node_code.VERSIONS_HINT


def test_what_cannot_be_read_or_written_is_named(required, tmp_path):
    absent = tmp_path / "absent"
    cases = (
        (replace(required, files=(ReadableFile(path=str(absent), size=4),)), absent),
        (replace(required, files=(ReadableFile(path=str(absent), size=None),)), absent),
        (replace(required, folders=(SharedFolder(path=str(absent)),)), absent),
        (replace(required, files=(replace(required.files[0], size=5),)), tmp_path / "scan.bin"),
    )
    for required_here, path in cases:
        problem = node_problem(required_here)
        assert str(path) in problem.text
        assert problem.hint == node_code.FOLDERS_HINT
    problem = node_problem(replace(required, versions={"salsanext": "2.0"}))
    assert problem.hint == node_code.VERSIONS_HINT


def test_another_arithmetic_of_int8_is_named(required, monkeypatch):
    here = device.int8_arithmetic()
    assert node_problem(replace(required, int8_arithmetic=here)) is None
    others = set()
    for floats, tiles in (([], False), (["avx512_bf16"], False), (["amx_bf16"], True)):
        monkeypatch.setattr(device, "bfloat16_instructions", lambda floats=floats: floats)
        monkeypatch.setattr(device, "multiplies_tiles_of_bytes", lambda tiles=tiles: tiles)
        others.add(device.int8_arithmetic())
        assert node_problem(required) is None
        problem = node_problem(replace(required, int8_arithmetic="other"))
        assert device.int8_arithmetic() in problem.text
        assert problem.hint == node_code.ARITHMETIC_HINT
    assert len(others) == 3


@pytest.fixture
def worker(tmp_path, monkeypatch):
    """Return a function that makes a worker of some work in this process."""
    for name in node_code.THREAD_VARIABLES:
        monkeypatch.setenv(name, os.environ.get(name, "1"))
    monkeypatch.chdir(tmp_path)

    def made(task, folder=tmp_path):
        process = WorkerProcess(
            run_id=str(id(task)), mark=MARK.get(), folder=folder, spelling=wording.used()
        )
        work = Work(task=task, process=process, stop=False)
        return NodeWorker(pickle.dumps(work), 1)

    return made


def test_a_worker_attempts_chunks(worker, required, tmp_path):
    made = worker(Write(tmp_path))
    assert made.open(required) is None
    chunk = pickle.loads(made.attempt(7, pickle.dumps(tuple(scans_of("a", "bad", "b")))))
    assert chunk.number == 7
    assert [attempt.result for attempt in chunk.attempts] == ["a", None, "b"]
    assert isinstance(chunk.attempts[1].error, FormatError)
    assert (tmp_path / "s/b").read_bytes() == b"b"


def test_a_worker_needs_the_current_folder_only_for_names_relative_to_it(
    worker, required, tmp_path, monkeypatch
):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    made = worker(Write(tmp_path), folder=elsewhere)
    elsewhere.rmdir()
    assert made.open(required) is None
    assert Path.cwd() == Path("/").absolute()
    pickle.loads(made.attempt(1, pickle.dumps(tuple(scans_of("a")))))
    assert (tmp_path / "s/a").read_bytes() == b"a"


def test_an_exception_of_a_worker_is_sent_with_its_traceback(worker, required, tmp_path):
    made = worker(Write(tmp_path))
    assert made.open(required) is None
    bug = pickle.loads(made.attempt(1, pickle.dumps(tuple(scans_of("bug")))))
    assert isinstance(bug, Bug)
    error = bug.noted()
    assert isinstance(error, ZeroDivisionError)
    assert "in __call__" in error.__notes__[0]


def test_a_node_that_lacks_something_after_a_failure_attempts_nothing(worker, required, tmp_path):
    made = worker(Write(tmp_path))
    assert made.open(required) is None
    Path(required.files[0].path).unlink()
    assert isinstance(made.attempt(1, pickle.dumps(tuple(scans_of("a")))), bytes)
    assert required.files[0].path in made.attempt(2, pickle.dumps(tuple(scans_of("bad")))).text


class Needs:
    """Work that needs a module of a package."""

    def __init__(self, module):
        self.module = module

    def __call__(self, scan):
        try:
            import_extra(self.module, "las")
        except MissingDependency as error:
            raise MissingDependency(scan.path, f"needs {error.subject}") from error


def test_a_package_that_only_a_node_lacks_is_no_fault_of_the_scan(worker, required):
    made = worker(Needs("absent_package.reader"))
    chunk = pickle.dumps(tuple(scans_of("a")))
    assert made.open(required) is None
    (attempt,) = pickle.loads(made.attempt(1, chunk)).attempts
    assert isinstance(attempt.error, MissingDependency)
    assert made.open(replace(required, modules=frozenset({"absent_package"}))) is None
    problem = made.attempt(2, chunk)
    assert "lacks absent_package" in problem.text
    assert problem.hint == node_code.VERSIONS_HINT
    assert missing_module(FormatError("a", "cut off")) == ""
    assert made.process() == os.getpid()


def test_a_worker_ends_before_it_names_a_file_after_the_run(
    worker, required, tmp_path, monkeypatch
):
    """Its probe is gone then; the unfinished file is removed."""

    def end(status):
        raise EndError(status)

    monkeypatch.setattr(node_code.os, "_exit", end)
    probe = Probe(path=str(tmp_path / "probe"), content=b"probe")
    folder = SharedFolder(path=str(tmp_path), probe=probe, is_written=True)
    Path(probe.path).write_bytes(probe.content)
    made = worker(Write(tmp_path))
    assert made.open(replace(required, folders=(folder,))) is None
    token = GUARD.set(GUARD.get())
    made.attempt(1, pickle.dumps(tuple(scans_of("a"))))
    Path(probe.path).unlink()
    with pytest.raises(EndError):
        made.attempt(2, pickle.dumps(tuple(scans_of("b"))))
    GUARD.reset(token)
    assert [path.name for path in (tmp_path / "s").iterdir()] == ["a"]


class EndError(BaseException):
    """End of the process."""


class Closed:
    """Task that cannot be opened."""

    max_chunk_scans = 1

    def open(self):
        raise FormatError("weights", "cut off", hint="copy it again")


def test_a_worker_says_why_it_cannot_begin(worker, required):
    assert node_problem(required) is None
    problem = worker(Closed()).open(required)
    assert (problem.text, problem.hint) == ("cannot begin: weights: cut off", "copy it again")
    assert not problem.trace
    torn = NodeWorker(b"no pickle", 1)
    problem = torn.open(required)
    assert problem.text.startswith("cannot begin: ")
    assert "UnpicklingError" in problem.trace
    folder = SharedFolder(path="/nowhere/at/all", is_written=True)
    absent = replace(required, folders=(folder,))
    assert "/nowhere/at/all" in worker(Closed()).open(absent).text
