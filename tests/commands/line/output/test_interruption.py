# SPDX-License-Identifier: MIT
"""Signals during a command: one line and the exit status for the first, an end at the next."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import python

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")

SIGNALS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
LINES = {
    signal.SIGINT: "interrupted: no file is incomplete\n",
    signal.SIGTERM: "terminated: no file is incomplete\n",
}
COMMAND = """
import os, signal, sys, time, typer
from salsanext_cli.commands.line.output.console import guarded
from salsanext_cli.commands.line.output.interruption import handle_signals
from salsanext_cli.core.errors import MissingDependency
signal.signal(signal.SIGINT, signal.default_int_handler)
handle_signals()
def send(number, process=None):
    os.kill(process or os.getpid(), number)
    time.sleep(10)
def command():
    BODY
app = typer.Typer()
app.command()(guarded(command))
app([])
"""
IMPORT = """
import os, signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == "salsanext_cli.commands.line.commands.pick":
            os.kill(os.getpid(), NUMBER)
sys.meta_path.insert(0, Finder())
signal.signal(signal.SIGINT, signal.default_int_handler)
from salsanext_cli.__main__ import main
sys.argv.append("models")
main()
"""


FORKS = """
import gc, json, os, signal, sys, typer
from salsanext_cli.commands.line.output import console, interruption
app = typer.Typer()
app.command()(lambda: None)
app([], standalone_mode=False)  # Imports what typer needs to build a command
gc.freeze()  # A fork that ends need not search for garbage in what it shares
for line in sys.stdin:
    request = json.loads(line)
    process = os.fork()
    if not process:
        for stream, path in enumerate(request["streams"], start=1):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), stream)
        signal.setitimer(signal.ITIMER_REAL, request["max_s"])
        break
    print(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), flush=True)
else:
    sys.exit()
exec(request["code"], {"__name__": "__main__"})
"""
"""Runs programs in forks, whose interpreters end as usual: imports take most of a short program."""


MAX_S = 120
"""Time after which a program is killed that has not ended, such as one that ignores a signal."""


class Forks:
    """A process that has imported the command line, and runs programs in forks of it."""

    def __init__(self, folder: Path) -> None:
        self.streams = [folder / "stdout", folder / "stderr"]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self.server = subprocess.Popen([sys.executable, "-c", FORKS], **pipes)

    def run(self, code: str, max_s: float = MAX_S) -> subprocess.CompletedProcess[str]:
        """Run a program, and return how it ended; it is killed after some seconds."""
        request = {"code": code, "streams": [*map(str, self.streams)], "max_s": max_s}
        self.server.stdin.write(json.dumps(request) + "\n")
        self.server.stdin.flush()
        status = int(self.server.stdout.readline())
        stdout, stderr = (path.read_text("utf-8") for path in self.streams)
        return subprocess.CompletedProcess(code, status, stdout, stderr)


@pytest.fixture(scope="module")
def forks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Forks]:
    made = Forks(tmp_path_factory.mktemp("forks"))
    yield made
    made.server.communicate()
    assert made.server.returncode == 0


def interrupted(forks: Forks, body: str, number: signal.Signals) -> None:
    """Require that a command with this body ends with one line and the exit status of a signal."""
    ended = forks.run(COMMAND.replace("BODY", body))
    assert (ended.stdout, ended.stderr, ended.returncode) == ("", LINES[number], 128 + number)


def test_a_program_that_does_not_end_is_killed(forks):
    ended = forks.run("import time; time.sleep(30)", max_s=0.1)
    assert ended.returncode == -signal.SIGALRM


@SIGNALS
def test_a_signal_during_a_command_or_while_commands_are_imported(forks, number):
    interrupted(forks, f"send({number:d})", number)
    ended = python(IMPORT.replace("NUMBER", f"{number:d}"))
    assert (ended.stdout, ended.stderr, ended.returncode) == ("", LINES[number], 128 + number)


@SIGNALS
def test_a_signal_while_a_library_makes_a_class(number, tmp_path):
    """Classes are made by `exec`, after whose interruption ``python -m`` would end with SIGINT."""
    body = f'exec("send({number:d})", globals())'
    (tmp_path / "trial.py").write_text(COMMAND.replace("BODY", body))
    paths = os.pathsep.join((str(tmp_path), *sys.path))
    ended = subprocess.run(
        [sys.executable, "-m", "trial"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "PYTHONPATH": paths},
    )
    assert (ended.stdout, ended.stderr, ended.returncode) == ("", LINES[number], 128 + number)


def test_a_signal_that_a_library_ignores_or_turns_into_another_error_counts(forks):
    body = "\n    try: send(2)\n    except KeyboardInterrupt: raise MissingDependency('a', 'b')"
    interrupted(forks, body, signal.SIGINT)
    interrupted(forks, "\n    try: send(2)\n    except KeyboardInterrupt: pass", signal.SIGINT)


def test_the_same_signal_twice_lets_the_command_tidy_up(forks, tmp_path):
    """As `timeout` sends it."""
    tidy = f"os.kill(os.getpid(), 15); open({str(tmp_path / 'tidy')!r}, 'w').close()"
    interrupted(forks, f"\n    try: send(15)\n    finally: {tidy}", signal.SIGTERM)
    assert (tmp_path / "tidy").exists()


def test_a_second_signal_ends_the_process_at_once(forks):
    body = "\n    try: send(2)\n    finally: time.sleep(1.2); send(15)"
    ended = forks.run(COMMAND.replace("BODY", body))
    assert (ended.stdout, ended.stderr, ended.returncode) == ("", "", 143)


def test_a_signal_ends_a_forked_process_at_once(forks):
    # A signal that comes before the child has begun is lost.
    body = """
    if not (child := os.fork()):
        while True: time.sleep(1)
    while not (ended := os.waitpid(child, os.WNOHANG))[0]:
        os.kill(child, 15)
        time.sleep(0.05)
    print(os.waitstatus_to_exitcode(ended[1]))
"""
    ended = forks.run(COMMAND.replace("BODY", body))
    assert (ended.stdout, ended.stderr, ended.returncode) == ("143\n", "", 0)


def test_an_ignored_signal_stays_ignored(forks):
    """As that of a shell that starts a command in the background."""
    ignoring = COMMAND.replace("signal.default_int_handler", "signal.SIG_IGN")
    ended = forks.run(ignoring.replace("BODY", "os.kill(os.getpid(), 2); print('done')"))
    assert (ended.stdout, ended.stderr, ended.returncode) == ("done\n", "", 0)


@pytest.mark.parametrize(
    ("body", "line"),
    [
        ("writing('predict', True)", "no scan is finished in this run"),
        ("writing('predict', False)", "3 of 8 scans are processed; no file is incomplete"),
        ("writing('synth', True, 'sequences')", "3 of 8 sequences are processed; no file is in"),
        ("writing('eval', True, at_end=True)", "nothing is finished; no file is incomplete"),
    ],
)
def test_the_line_states_what_is_finished(forks, body, line):
    steps = "" if "no scan" in line else "bar(3, 8);"
    work = f"""
    from salsanext_cli.commands.line.output.progress import writing
    with {body} as bar: {steps} send(2)"""
    ended = forks.run(COMMAND.replace("BODY", work))
    assert ended.stderr.startswith(f"interrupted: {line}")
    assert ended.returncode == 130


def test_what_was_finished_before_is_not_stated_again(forks):
    work = """
    from salsanext_cli.commands.line.output.progress import writing
    with writing('predict', True) as bar: bar(3, 8)
    send(2)"""
    interrupted(forks, work, signal.SIGINT)


DROPPED = """
    import weakref
    class Thing: pass
    thing = Thing()
    reference = weakref.ref(thing, lambda _: os.kill(os.getpid(), NUMBER))
    del thing
    NEXT
    time.sleep(10)
"""
"""A signal that Python drops, as it does errors in callbacks of weak references, as of imports."""
PROGRESS = """
    from salsanext_cli.commands.line.output.progress import writing
    with writing('predict', True) as bar: bar(0, 8)"""
TRAINING = """
    from salsanext_cli.commands.line.output.interruption import require_uninterrupted
    require_uninterrupted()"""


@SIGNALS
@pytest.mark.parametrize("step", [PROGRESS, TRAINING])
def test_a_signal_that_python_drops_ends_a_command_at_its_next_step(forks, number, step):
    body = DROPPED.replace("NUMBER", f"{number:d}").replace("    NEXT", step)
    ended = forks.run(COMMAND.replace("    BODY", body))
    (line,) = ended.stderr.splitlines()
    assert line.startswith(LINES[number].partition(":")[0])
    assert ended.returncode == 128 + number


def test_other_errors_that_python_drops_are_printed(forks):
    body = """
    import weakref
    class Thing: pass
    thing = Thing()
    reference = weakref.ref(thing, lambda _: 1 / 0)
    del thing
    """
    ended = forks.run(COMMAND.replace("    BODY", body))
    assert "ZeroDivisionError" in ended.stderr


@SIGNALS
def test_a_signal_while_openvino_is_imported_does_not_choose_another_engine(number):
    """Its module in C++ turns the interruption into an `ImportError`."""
    body = f"""
    from importlib.abc import Loader, MetaPathFinder
    from importlib.machinery import ModuleSpec
    from salsanext_cli.core.engines.registry import choose_engine
    class Interrupted(MetaPathFinder, Loader):
        def find_spec(self, name, *_):
            return ModuleSpec(name, self) if name == "openvino" else None
        def exec_module(self, module):
            try:
                send({number:d})
            except KeyboardInterrupt as error:
                raise ImportError("initialization failed") from error
    sys.meta_path.insert(0, Interrupted())
    print(choose_engine("auto", "cpu"))
    """
    ended = python(COMMAND.replace("    BODY", body))
    assert (ended.stdout, ended.stderr, ended.returncode) == ("", LINES[number], 128 + number)


WORKERS = """
    import joblib
    from pathlib import Path
    from salsanext_cli.runs.loop.run import RunOptions, run_over_scans
    from worker_tasks import Write, scans_of
    start = joblib.Parallel.__call__
    def interrupted(self, calls):
        results = start(self, calls)
        os.kill(os.getpid(), NUMBER)
        return results
    joblib.Parallel.__call__ = interrupted
    scans = scans_of(*(f"{n:02d}" for n in range(20)))
    run_over_scans(Write(Path('OUT'), 0.1), scans, RunOptions(jobs=2))
"""


LATE = """
    from joblib.externals.loky import process_executor
    submit = process_executor.ProcessPoolExecutor.submit
    def slowly(self, *arguments):
        future = submit(self, *arguments)
        time.sleep(0.1)
        return future
    process_executor.ProcessPoolExecutor.submit = slowly
    manager = process_executor._ExecutorManagerThread
    wait = manager.wait_result_broken_or_wakeup
    def late(self):
        result = wait(self)
        time.sleep(1)
        return result
    manager.wait_result_broken_or_wakeup = late
"""
"""The thread of loky that sends chunks to workers sees them only when they have been removed."""


@pytest.mark.parametrize(
    ("number", "before"), [(signal.SIGINT, ""), (signal.SIGTERM, ""), (signal.SIGTERM, LATE)]
)
def test_nothing_follows_the_line_if_a_signal_arrives_while_workers_are_started(
    tmp_path, number, before
):
    work = before + WORKERS.replace("NUMBER", f"{number:d}").replace("OUT", str(tmp_path / "out"))
    code = COMMAND.replace("    BODY", work)
    paths = os.pathsep.join(filter(None, sys.path))
    ended = python(code, PYTHONPATH=paths, TMPDIR=str(tmp_path))
    assert (ended.stdout, ended.stderr, ended.returncode) == ("", LINES[number], 128 + number)
    assert not list(tmp_path.glob("salsanext-*"))
