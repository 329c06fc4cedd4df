# SPDX-License-Identifier: MIT
"""The line of a text of Ray that states the cause."""

from salsanext_cli.runs.loop.cluster.error_lines import cause_line, first_line, one_line

DEATH = """The actor died unexpectedly before finishing this task.
\tclass_name: NodeWorker
\tactor_id: 01
The actor is dead because its worker process has died. Worker exit type: SYSTEM_ERROR
"""
FAILED_CREATION = """The actor died because of an error raised in its creation task, \
\x1b[36mray::NodeWorker.__init__()\x1b[39m (pid=1, ip=127.0.0.1)
  File "a.py", line 1, in b
Traceback (most recent call last):
ModuleNotFoundError: No module named 'numpy'
"""


def test_the_cause_of_an_error_is_told():
    assert cause_line(Exception(DEATH)).startswith("The actor is dead because its worker process")
    assert cause_line(Exception(FAILED_CREATION)) == "ModuleNotFoundError: No module named 'numpy'"
    assert cause_line(Exception("\n  no room \nmore")) == "no room"
    assert cause_line(Exception()) == "Exception"


def test_an_error_is_told_by_its_first_line_or_on_one_line():
    assert one_line(Exception("versions:\n  2.51\n  2.60")) == "versions: 2.51 2.60"
    assert one_line(Exception()) == "Exception"
    assert first_line(Exception("\n  the worker died. \nmore")) == "the worker died."
    assert first_line(Exception()) == "Exception"
