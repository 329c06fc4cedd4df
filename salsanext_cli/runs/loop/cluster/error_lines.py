# SPDX-License-Identifier: MIT
"""One line of an error of Ray, whose texts are paragraphs."""

import re

CAUSE_OF_END = "The actor is dead because"  # Of Ray
COLOUR = re.compile(r"\x1b\[[0-9;]*m")


def cause_line(error: Exception) -> str:
    """Return the line of an error of Ray that states its cause.

    The cause of the end of a worker follows its ids. An exception of its code is the last line of
    a traceback.
    """
    lines = [line.strip() for line in COLOUR.sub("", str(error)).splitlines() if line.strip()]
    ends = [line for line in lines if line.startswith(CAUSE_OF_END)]
    if ends:
        return ends[0]
    if any("Traceback" in line or line.startswith("ray::") for line in lines):
        return lines[-1]
    return lines[0] if lines else type(error).__name__


def first_line(error: Exception) -> str:
    """Return the first line of the text of an error that is not empty."""
    lines = (line.strip() for line in str(error).splitlines())
    return next(filter(None, lines), type(error).__name__)


def one_line(error: Exception) -> str:
    """Return the text of an error on one line, such as two versions that Ray lists below it."""
    return " ".join(str(error).split()) or type(error).__name__
