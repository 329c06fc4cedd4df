# SPDX-License-Identifier: MIT
"""Signals that wait, also if another thread receives them."""

import os
import signal
import threading
import time

import pytest

from salsanext_cli.runs.loop.blocked_signals import signals_blocked

pytestmark = pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="no masks")


@pytest.fixture
def another_thread():
    """Run a thread that does not block signals, as those of libraries."""
    end = threading.Event()
    thread = threading.Thread(target=end.wait)
    thread.start()
    yield
    end.set()
    thread.join()


def interrupt_blocked() -> list[str]:
    """Send this process a signal in a body that blocks it; return the steps that were reached."""
    steps = []
    with pytest.raises(KeyboardInterrupt):  # noqa: PT012 - the steps are the test
        with signals_blocked(signal.SIGINT, signal.SIGTERM):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.1)
            steps.append("end of the body")
        steps.append("after the body")
    return steps


def test_a_signal_waits_for_the_end_of_the_body():
    assert interrupt_blocked() == ["end of the body"]


@pytest.mark.usefixtures("another_thread")
def test_a_signal_that_another_thread_receives_waits_too():
    before = signal.getsignal(signal.SIGINT)
    assert interrupt_blocked() == ["end of the body"]
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.usefixtures("another_thread")
def test_a_signal_counts_after_an_error():
    def fail():
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.1)
        raise ZeroDivisionError

    with pytest.raises(KeyboardInterrupt), signals_blocked(signal.SIGINT):
        fail()


def test_a_thread_other_than_the_main_one_changes_no_handler():
    seen = []

    def work():
        with signals_blocked(signal.SIGINT):
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.getsignal(signal.SIGINT)]


def test_the_default_action_stays():
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    with signals_blocked(signal.SIGTERM):
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
