# SPDX-License-Identifier: MIT
"""The loop over scans, with a fake job and events instead of clocks."""

import gc
import threading
import weakref
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from salsanext_cli.core.engines.batches import BatchSize
from salsanext_cli.core.engines.device_copies import pinned, pinned_array
from salsanext_cli.core.errors import FormatError, SalsanextError
from salsanext_cli.io.files.atomic import MARK
from salsanext_cli.runs.loop.pipeline import Pipeline
from salsanext_cli.runs.scans.scan_file import ScanFile

FILES = [
    ScanFile(sequence="00", stem=str(number), path=Path(f"{number}.bin")) for number in range(7)
]
STEMS = [file.stem for file in FILES]
STEPS = ("prepare", "compute", "finish")
WAIT_S = 30.0
NO_SCAN = FormatError("a scan", "no scan")


class Content:
    """Content of a scan in memory."""

    def __init__(self, stem: str) -> None:
        self.stem = stem


class Job:
    """Steps that record their calls, and fail for some of them."""

    def __init__(self, fails=(), error: BaseException = NO_SCAN) -> None:
        self.done: list[tuple[str, str]] = []
        self.threads: dict[str, set[str]] = {step: set() for step in STEPS}
        self.batches: list[list[str]] = []
        self.fails, self.error = fails, error

    def step(self, name: str, stem: str) -> None:
        self.threads[name].add(threading.current_thread().name.rpartition("_")[0])
        if (name, stem) in self.fails:
            raise self.error
        self.done.append((name, stem))

    def prepare(self, file: ScanFile) -> Content:
        self.step("prepare", file.stem)
        return Content(file.stem)

    def compute(self, scans: Sequence[Content]) -> list[Content]:
        self.batches.append([scan.stem for scan in scans])
        for scan in scans:
            self.step("compute", scan.stem)
        return [Content(scan.stem) for scan in scans]

    def finish(self, scan: Content, computed: Content) -> str:
        assert scan.stem == computed.stem
        self.step("finish", scan.stem)
        return scan.stem

    def of(self, name: str) -> list[str]:
        return [stem for step, stem in self.done if step == name]


def pipeline(job, batch: int = 1, readers: int = 1) -> Pipeline:
    return Pipeline(job=job, batch=BatchSize(batch, "scans"), readers=readers)


@pytest.mark.parametrize(("batch", "readers"), [(1, 1), (3, 1), (1, 4), (4, 2)])
def test_attempts_come_in_the_order_of_the_files_and_each_step_has_its_threads(batch, readers):
    job = Job()
    attempts = [*pipeline(job, batch, readers).run(iter(FILES))]
    assert [attempt.file for attempt in attempts] == FILES
    assert [attempt.get() for attempt in attempts] == STEMS
    assert job.of("compute") == job.of("finish") == STEMS
    assert sorted(job.of("prepare")) == STEMS
    assert job.threads["prepare"] == {"salsanext-reader"}
    assert job.threads["finish"] == {"salsanext-writer"}
    assert job.threads["compute"] == {threading.current_thread().name.rpartition("_")[0]}


def test_no_files_are_no_attempts():
    assert [*pipeline(Job(), 3, 2).run([])] == []


def test_the_next_scan_is_prepared_and_the_last_is_finished_while_one_is_computed():
    """Each step waits for what is to happen meanwhile, so that anything else is a timeout."""
    prepared, computing, finished = ([threading.Event() for _ in FILES] for _ in range(3))
    mark = f"{MARK.get()}x"

    class Waiting(Job):
        def prepare(self, file):
            number = int(file.stem)
            assert MARK.get() == mark
            assert not any(event.is_set() for event in computing[number:])
            prepared[number].set()
            return super().prepare(file)

        def compute(self, scans):
            number = int(scans[0].stem)
            computing[number].set()
            assert number + 1 == len(FILES) or prepared[number + 1].wait(WAIT_S)
            assert number == 0 or finished[number - 1].wait(WAIT_S)
            # No other is prepared ahead.
            assert not any(event.is_set() for event in prepared[number + 2 :])
            return super().compute(scans)

        def finish(self, scan, computed):
            assert MARK.get() == mark
            number = int(scan.stem)
            assert number + 1 == len(FILES) or computing[number + 1].wait(WAIT_S)
            finished[number].set()
            return super().finish(scan, computed)

    token = MARK.set(mark)
    try:
        assert [*pipeline(Waiting()).results(FILES)] == STEMS
    finally:
        MARK.reset(token)


@pytest.mark.parametrize(("batch", "readers"), [(1, 1), (2, 1), (1, 3), (2, 3)])
def test_no_more_scans_than_the_bound_are_in_memory(batch, readers):
    alive, most = weakref.WeakSet[Content](), 0
    lock = threading.Lock()

    class Counting(Job):
        def prepare(self, file):
            nonlocal most
            content = super().prepare(file)
            with lock:
                alive.add(content)
                most = max(most, len(alive))
            return content

    files = [ScanFile(sequence="00", stem=str(number), path=Path("x.bin")) for number in range(60)]
    for attempt in pipeline(Counting(), batch, readers).run(files):
        assert not attempt.error
    gc.collect()
    assert not alive
    assert most <= 2 * batch + max(batch, readers)


@pytest.mark.parametrize("batch", [1, 3])
@pytest.mark.parametrize("failing", STEPS)
def test_an_error_of_the_user_belongs_to_its_scan(failing, batch):
    failed = ["0", "3", "6"]
    job = Job(fails=[(failing, stem) for stem in failed])
    attempts = [*pipeline(job, batch).run(FILES)]
    assert [attempt.file for attempt in attempts] == FILES
    assert [attempt.file.stem for attempt in attempts if attempt.error is job.error] == failed
    assert job.of("finish") == [stem for stem in STEMS if stem not in failed]
    with pytest.raises(SalsanextError):
        attempts[3].get()


def run(job, reported, batch: int = 1) -> None:
    def report(attempt):
        reported.append(attempt.get())

    with closing(pipeline(job, batch).run(FILES, report)) as attempts:
        for attempt in attempts:
            report(attempt)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ZeroDivisionError()])
@pytest.mark.parametrize("failing", STEPS)
def test_an_interrupt_ends_the_run_after_the_scan_that_is_being_finished(failing, error):
    """A bug does too. The finished scans are reported, and no others."""
    job, reported = Job(fails=[(failing, "3")], error=error), []
    with pytest.raises(type(error)):
        run(job, reported)
    assert reported == job.of("finish") == ["0", "1", "2"]
    assert not {"5", "6"} & {*job.of("compute")}


def test_an_interrupt_while_a_scan_is_being_finished_waits_for_it(monkeypatch):
    """The signal comes while the thread that computes waits for the one that writes."""
    reported = []
    finishing, goes_on = threading.Event(), threading.Event()

    class Slow(Job):
        def finish(self, scan, computed):
            if scan.stem == "1":
                finishing.set()
                assert goes_on.wait(WAIT_S)
            return super().finish(scan, computed)

        def compute(self, scans):
            if scans[0].stem == "2":
                assert finishing.wait(WAIT_S)
                threading.Timer(0.0, goes_on.set).start()
                raise KeyboardInterrupt
            return super().compute(scans)

    job = Slow()
    with pytest.raises(KeyboardInterrupt):
        run(job, reported)
    assert reported == job.of("finish") == ["0", "1"]


@pytest.mark.parametrize("batch", [1, 3])
def test_every_finished_scan_is_reported_when_the_report_or_the_caller_stops_the_run(batch):
    class StoppedAtTwo(list):
        def append(self, stem):
            super().append(stem)
            if len(self) == 2:
                raise KeyboardInterrupt

    job, reported = Job(), StoppedAtTwo()
    with pytest.raises(KeyboardInterrupt):
        run(job, reported, batch)
    assert reported == job.of("finish")
    job, late = Job(), []
    attempts = pipeline(job, batch).run(FILES, lambda attempt: late.append(attempt.get()))
    assert next(attempts).get() == "0"
    attempts.close()
    assert ["0", *late] == job.of("finish") == STEMS[: len(late) + 1]
    assert len(late) + 1 >= batch
    assert not any(t.name.startswith(("salsanext-r", "salsanext-w")) for t in threading.enumerate())


class Short(Job):
    """Memory for so many scans at once."""

    def __init__(self, room: int, error=MemoryError) -> None:
        super().__init__()
        self.room, self.no_room = room, error

    def compute(self, scans):
        computed = super().compute(scans)
        if len(scans) > self.room:
            raise self.no_room("CUDA out of memory")
        return computed


@pytest.mark.parametrize("error", [MemoryError, RuntimeError])
def test_memory_that_runs_out_halves_the_batch_for_good(error, caplog):
    job = Short(2, error)
    assert [*pipeline(job, 4).results(FILES)] == STEMS
    assert [len(batch) for batch in job.batches] == [4, 2, 2, 2, 1]
    assert [record.args for record in caplog.records] == [(4, "scans", 2)]


def test_a_scan_that_does_not_fit_alone_is_an_error_of_this_scan():
    job = Short(0)
    attempts = [*pipeline(job, 2).run(FILES[:3])]
    assert [attempt.error.code for attempt in attempts] == ["format"] * 3
    assert attempts[1].error.subject == "1.bin"
    assert [len(batch) for batch in job.batches] == [2, 1, 1, 1]


@pytest.mark.parametrize("failing", ["prepare", "finish"])
def test_memory_that_runs_out_in_another_step_is_an_error_of_its_scan(failing):
    job = Job(fails=[(failing, "1")], error=MemoryError())
    attempts = [*pipeline(job).run(FILES)]
    assert [attempt.file.stem for attempt in attempts if attempt.error] == ["1"]


def no_memory(cause=None, context=None):
    """Return an error as if raised from a cause, or while another was handled."""
    error = MemoryError()
    error.__cause__ = cause
    error.__context__ = context
    return error


@pytest.mark.parametrize(
    ("error", "device"),
    [
        (MemoryError(), "cpu"),
        (no_memory(cause=MemoryError()), "cpu"),
        (no_memory(context=torch.OutOfMemoryError()), "cpu"),
        (torch.OutOfMemoryError(), "cuda:1"),
        (no_memory(cause=torch.OutOfMemoryError()), "cuda:1"),
        (RuntimeError("CUDA error: out of memory"), "cuda:1"),
        (RuntimeError("CUDA error: CUBLAS_STATUS_ALLOC_FAILED"), "cuda:1"),
    ],
)
@pytest.mark.parametrize("step", STEPS)
def test_the_memory_that_runs_out_is_named_whatever_the_step(step, error, device):
    """A scan is computed again in `finish`; the memory of the host is "cpu"."""
    job = Job(fails=[(step, "1")], error=error)
    attempts = [*replace(pipeline(job), device="cuda:1").run(FILES)]
    (failed,) = [attempt.error for attempt in attempts if attempt.error]
    assert failed.problem.endswith(f" {device}")


@pytest.mark.parametrize("copy", [pinned_array, pinned])
def test_page_locked_memory_is_that_of_the_host(monkeypatch, copy):
    """CUDA has one error for both, and readers copy scans for the GPU."""

    def fail(*_, **__):
        raise RuntimeError("CUDA error: out of memory")

    monkeypatch.setattr(torch, "empty", fail)
    monkeypatch.setattr(torch.Tensor, "pin_memory", fail)

    class CopyingJob(Job):
        def prepare(self, file):
            copy(np.ones(3) if copy is pinned_array else torch.ones(3), "cuda:1")

    attempts = replace(pipeline(CopyingJob()), device="cuda:1").run(FILES[:1])
    (failed,) = [attempt.error for attempt in attempts]
    assert failed.problem.endswith(" cpu")
    assert "jobs" in failed.hint


def test_a_batch_that_another_thread_halved_does_not_grow_again():
    size = BatchSize(16, "scans")

    def too_large(items):
        if len(items) > 1:
            size.most = 1  # As another thread may set it meanwhile
            raise MemoryError
        return items

    assert [*size.in_batches(too_large, range(16))] == [range(i, i + 1) for i in range(16)]
    assert size.most == 1
