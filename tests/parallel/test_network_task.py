# SPDX-License-Identifier: MIT
"""Steps of scans that overlap: the order, errors and interrupts are those of one after another."""

import threading
from pathlib import Path

import pytest

from salsanext_cli.errors import FormatError
from salsanext_cli.files.atomic import MARK
from salsanext_cli.parallel.run import overlapping
from salsanext_cli.results.layout import ScanFile

FILES = [ScanFile("00", str(number), Path(f"{number}.bin")) for number in range(5)]
STEPS = ("read", "compute", "write")
NO_SCAN = FormatError("a scan", "no scan")


class Work:
    """Steps that note what was done, and fail where they are told to."""

    def __init__(self, fails=(), error=NO_SCAN):
        self.done, self.fails, self.error = [], fails, error

    def step(self, name, stem):
        if (name, stem) in self.fails:
            raise self.error
        self.done.append((name, stem))

    def begin(self, file):
        self.step("read", file.stem)
        yield
        self.step("compute", file.stem)
        yield
        self.step("write", file.stem)
        yield f"{file.stem} in {threading.current_thread().name}"


def of(name, done):
    return [stem for step, stem in done if step == name]


@pytest.mark.parametrize("failing", [*STEPS, None])
def test_attempts_come_in_order_and_a_failure_is_of_its_scan_only(failing):
    work = Work(fails=[(failing, "0"), (failing, "2"), (failing, "4")])
    attempts = list(overlapping(work.begin, iter(FILES)))
    assert [file for file, _, _ in attempts] == FILES
    errors = [file.stem for file, result, error in attempts if error is NO_SCAN]
    assert errors == (["0", "2", "4"] if failing else [])
    for name in STEPS:
        stems = of(name, work.done)
        failed_before = failing and STEPS.index(failing) <= STEPS.index(name)
        assert stems == (["1", "3"] if failed_before else ["0", "1", "2", "3", "4"])
    assert all(error or "salsanext-files" in result for _, result, error in attempts)


def test_one_scan_is_computed_while_the_last_is_written_and_the_next_is_read_but_no_other():
    read, written = ([threading.Event() for _ in FILES] for _ in range(2))
    mark = MARK.get()

    def begin(file):
        number = int(file.stem)
        read[number].set()
        assert MARK.get() == own
        yield
        assert threading.current_thread() is threading.main_thread()
        assert number + 1 == len(FILES) or read[number + 1].wait(10)
        assert number == 0 or written[number - 1].wait(10)
        assert not any(event.is_set() for event in read[number + 2 :])
        yield
        written[number].set()
        assert MARK.get() == own
        yield number

    own = f"{mark}x"
    token = MARK.set(own)
    try:
        assert [result for _, result, _ in overlapping(begin, FILES)] == [0, 1, 2, 3, 4]
    finally:
        MARK.reset(token)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ZeroDivisionError()])
def test_what_was_written_before_an_interrupt_is_told_and_nothing_is_written_after(error):
    work, told = Work(fails=[("compute", "2")], error=error), []

    def run():
        for file, _, _ in overlapping(work.begin, FILES):
            told.append(file.stem)

    with pytest.raises(type(error)):
        run()
    assert told == of("write", work.done) == ["0", "1"]
