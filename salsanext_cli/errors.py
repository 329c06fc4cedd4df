# SPDX-License-Identifier: MIT
"""Errors that the user can correct, and the text of messages.

The library raises these; only the command line prints them and chooses the exit status.
Anything else that escapes is a bug and keeps its traceback.
"""

import logging
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, ClassVar

NOTICE = 25  # Log level of messages for every user that are not warnings
MAX_NAMES_SHOWN = 3  # Files or scans that a message names
SHOWN_CHARACTERS = 100  # Longest text of a wrong value in an error
UNDECODED = {code: f"\\x{code & 0xFF:02x}" for code in range(0xDC80, 0xDD00)}
"""Bytes of names that are no text, as Python decodes them."""
CONTROL = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160))}
DIRECTION = {0x061C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A)}
"""Characters that end lines or turn the direction of text, so that a name shows as another one."""
ESCAPES = UNDECODED | CONTROL | {code: f"\\u{code:04x}" for code in DIRECTION}
NO_MEMORY = (
    *("allocate memory", "bad_alloc", "bad allocation", "can't alloc"),
    *("failed to map segment", "can't start new thread"),
    *("cuda out of memory", "cuda error: out of memory"),
    *("cublas_status_alloc_failed", "cudnn_status_alloc_failed", "cublas_status_not_initialized"),
)
"""Words of the system, of Python, torch, CUDA and OpenVINO where memory runs out."""


def printable(text: str) -> str:
    """Return a text with what is no text escaped, which the name of a file may hold."""
    return text.translate(ESCAPES)


def escaped(data: Any) -> Any:
    """Return plain data with the bytes of names that are no text escaped, for other programs."""
    if isinstance(data, str):
        return data.translate(UNDECODED)
    if isinstance(data, Mapping):
        return {escaped(key): escaped(value) for key, value in data.items()}
    return [escaped(value) for value in data] if isinstance(data, list | tuple) else data


def counted(count: int, noun: str) -> str:
    """Return a number and a noun, in the plural unless it is one: "1 scan", "2,000 scans"."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def first_few(names: Sequence[object]) -> str:
    """Return the first names, and how many more there are."""
    more = len(names) - MAX_NAMES_SHOWN
    shown = ", ".join(map(str, names[:MAX_NAMES_SHOWN]))
    return f"{shown} and {more} more" if more > 0 else shown


def error_text(error: BaseException) -> str:
    """Return the message of an error on one line of limited length."""
    if isinstance(error, RecursionError):
        return "nested too deeply"
    return shortened(" ".join(str(error).split()) or type(error).__name__, 3 * SHOWN_CHARACTERS)


def shortened(value: object, length: int = SHOWN_CHARACTERS) -> str:
    """Return the text of a value, shortened to a length."""
    if isinstance(value, int) and value.bit_length() > 4 * length:
        # Python refuses to write out numbers of thousands of digits.
        return f"a number of {value.bit_length()} bits"
    try:
        text = value if isinstance(value, str) else repr(value)
    except (ValueError, RecursionError):
        return f"a {type(value).__name__}"
    return text if len(text) <= length else text[: length - 1] + "…"


def quoted(value: object) -> str:
    """Return the text of a value, shortened, and of a text in quotation marks."""
    return shortened(repr(value) if isinstance(value, str) else value)


def with_hint(headline: str, hint: str) -> str:
    """Return a message with a line for its hint, if there is one."""
    return f"{headline}\nhint: {hint}" if hint else headline


class SalsanextError(Exception):
    """A mistake explained as ``SUBJECT: problem (expected X)``, and a line ``hint: what to do``.

    Parameters
    ----------
    subject : object
        File, folder, option or setting that is wrong.
    problem : str, optional
        What is wrong with it.
    expected : str, optional
        Content or state that is required.
    hint : str, optional
        What the user can do.

    Attributes
    ----------
    code : str
        Kind of the mistake, for programs; it stays when messages change.
    reported_elsewhere : bool
        Whether another process of the run reports the error, so that it is reported once.
    """

    code: ClassVar[str] = "error"
    reported_elsewhere: bool = False

    def __init__(
        self, subject: object, problem: str = "", expected: str = "", hint: str = ""
    ) -> None:
        super().__init__(str(subject), problem, expected, hint)
        self.subject = str(subject)
        self.problem = problem
        self.expected = expected
        self.hint = hint

    @property
    def headline(self) -> str:
        """The message without the hint, on one line."""
        text = ": ".join(part for part in (self.subject, self.problem) if part)
        return printable(f"{text} (expected {self.expected})" if self.expected else text)

    def __str__(self) -> str:
        return with_hint(self.headline, printable(self.hint))


class UsageError(SalsanextError):
    """The command line or a setting is wrong (exit status 2)."""

    code = "usage"


class NoInputError(SalsanextError):
    """There is nothing to work on."""

    code = "no-input"


class FormatError(SalsanextError):
    """A file does not hold what its format promises."""

    code = "format"


class LabelError(SalsanextError):
    """Labels and scans, or labels and label space, do not fit."""

    code = "label"


class WeightsError(SalsanextError):
    """A weights file cannot be used."""

    code = "weights"


class OutputError(SalsanextError):
    """A result cannot be written, or would overwrite another."""

    code = "output"


class TrainingError(SalsanextError):
    """Training cannot start or cannot go on."""

    code = "training"


class WorkersLost(SalsanextError):  # noqa: N818 - the name says what is wrong
    """Worker processes died."""

    code = "workers-lost"


class MissingDependency(SalsanextError):  # noqa: N818 - the name says what is wrong
    """An optional package or a system library is absent."""

    code = "missing-dependency"


@cache
def warn_once(log: logging.Logger, message: str) -> None:
    """Log a warning that this process has not had yet."""
    log.warning("%s", message)


@cache
def notice_once(message: str, level: int = NOTICE) -> None:
    """Log what a reader assumes, which this process has not logged yet."""
    logging.getLogger(__name__).log(level, "%s", message)


def out_of_memory(error: BaseException | None) -> bool:
    """Say whether memory ran out, by an error that is not yet explained or one that it followed."""
    while error is not None and not isinstance(error, SalsanextError):
        text = str(error).lower()
        is_named = isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError"
        if is_named or any(words in text for words in NO_MEMORY):
            return True
        error = error.__cause__ or error.__context__
    return False
