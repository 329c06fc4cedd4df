# SPDX-License-Identifier: MIT
"""Errors that the user can correct, and the text of messages.

The library raises them; only the command line prints them and chooses the exit status. Any other
exception is a bug and keeps its traceback.
"""

import logging
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any, ClassVar

NOTICE = 25  # Log level of messages for every user that are not warnings
MAX_NAMES_SHOWN = 3  # Files or scans that a message names
LIKE = 0.6  # Least likeness of two words, as `difflib` measures it, of which one may mean the other
SHOWN_CHARACTERS = 100  # Longest text of a wrong value in an error
UNDECODED = {code: f"\\x{code & 0xFF:02x}" for code in range(0xDC80, 0xDD00)}
"""Escapes of the bytes in file names that are not text, as Python decodes them."""
CONTROL = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160))}
DIRECTION = {0x061C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A)}
"""Characters that end lines or change the direction of text, and so disguise a name."""
ESCAPES = UNDECODED | CONTROL | {code: f"\\u{code:04x}" for code in DIRECTION}
HINT = "\nhint: "  # Between a message and its hint
NO_MEMORY = (
    *("allocate memory", "bad_alloc", "bad allocation", "can't alloc"),
    *("failed to map segment", "can't start new thread"),
    *("cuda out of memory", "cuda error: out of memory"),
    *("cublas_status_alloc_failed", "cudnn_status_alloc_failed", "cublas_status_not_initialized"),
)
"""Words of the system, Python, torch, CUDA and OpenVINO when memory runs out."""


def printable(text: str) -> str:
    """Return a text, such as a file name, with all unprintable characters escaped."""
    return text.translate(ESCAPES)


def escaped(data: Any) -> Any:
    """Return plain data for other programs, with undecodable bytes of file names escaped."""
    if isinstance(data, str):
        return data.translate(UNDECODED)
    if isinstance(data, Mapping):
        return {escaped(key): escaped(value) for key, value in data.items()}
    return [escaped(value) for value in data] if isinstance(data, list | tuple) else data


def counted(count: int, noun: str) -> str:
    """Return a number and a noun, such as "1 scan" or "2,000 scans"."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def percentage(share: float, decimals: int = 1, *, figures: int | None = None) -> str:
    """Return a share, 0…1, in percent, such as "72.7 %".

    `figures`: number of significant figures, instead of decimals.
    """
    number = 100 * share
    if figures is None:
        return f"{number:.{decimals}f} %"
    rounded = float(f"{number:.{figures}g}")
    return f"{rounded:g} %"  # Without an exponent, which 100 with two figures would have


def first_few(names: Sequence[object]) -> str:
    """Return the first names and the number of further ones."""
    more = len(names) - MAX_NAMES_SHOWN
    shown = ", ".join(map(str, names[:MAX_NAMES_SHOWN]))
    return f"{shown} and {more} more" if more > 0 else shown


def nearest(word: str, words: Iterable[str], likeness: float = LIKE) -> str:
    """Return the word that was probably meant, also by its initials; empty if none is near.

    `likeness`: least likeness of the word, from 0 to 1 for an equal one.
    """
    from difflib import get_close_matches  # Only errors need it

    by_name = {known.lower(): known for known in words}
    typed = word.strip().lower()
    if close := get_close_matches(typed, by_name, 1, likeness):
        return by_name[close[0]]
    for name, known in by_name.items():
        initials = "".join(part[:1] for part in name.replace("-", "_").split("_"))
        if len(typed) > 1 and (typed == initials or name.startswith(typed)):
            return known
    return ""


def did_you_mean(word: str, words: Iterable[str]) -> str:
    """Return a hint with the word that was probably meant; empty if none is near."""
    likely = nearest(word, words)
    return f"did you mean {likely}?" if likely else ""


def error_text(error: BaseException) -> str:
    """Return the message of an error on one line of limited length."""
    if isinstance(error, RecursionError):
        return "nested too deeply"
    return shortened(" ".join(str(error).split()) or type(error).__name__, 3 * SHOWN_CHARACTERS)


def shortened(value: object, length: int = SHOWN_CHARACTERS) -> str:
    """Return the text of a value, shortened to a length."""
    if isinstance(value, int) and value.bit_length() > 4 * length:
        # Python refuses to convert numbers of thousands of digits.
        return f"a number of {value.bit_length()} bits"
    try:
        text = value if isinstance(value, str) else repr(value)
    except (ValueError, RecursionError):
        return f"a {type(value).__name__}"
    return text if len(text) <= length else text[: length - 1] + "…"


def quoted(value: object) -> str:
    """Return the shortened text of a value; a string gets quotation marks."""
    return shortened(repr(value) if isinstance(value, str) else value)


def with_hint(headline: str, hint: str) -> str:
    """Return a message, with its hint, if any, on a second line."""
    return f"{headline}{HINT}{hint}" if hint else headline


class SalsanextError(Exception):
    """A mistake: ``SUBJECT: problem (expected X)``, and ``hint: what to do`` on a second line.

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
        Kind of the mistake, for programs; it is stable when messages change.
    reported_elsewhere : bool
        Whether another process of the run reports the error.
    """

    code: ClassVar[str] = "error"
    reported_elsewhere: bool = False

    def __init_subclass__(cls, code: str = "") -> None:
        cls.code = code or cls.code

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


class UsageError(SalsanextError, code="usage"):
    """The command line or a setting is wrong (exit status 2)."""


class NoInputError(SalsanextError, code="no-input"):
    """The input contains nothing to process."""


class FormatError(SalsanextError, code="format"):
    """A file is damaged or not of its format."""


class LabelError(SalsanextError, code="label"):
    """Labels do not match their scan or their label space."""


class WeightsError(SalsanextError, code="weights"):
    """A weights file cannot be used."""


class OutputError(SalsanextError, code="output"):
    """A result cannot be written, or would replace another."""


class TrainingError(SalsanextError, code="training"):
    """Training cannot start or continue."""


class WorkersLost(SalsanextError, code="workers-lost"):  # noqa: N818 - the name states the problem
    """Worker processes died."""


class MissingDependency(SalsanextError, code="missing-dependency"):  # noqa: N818 - the name states the problem
    """An optional package or a system library is absent."""


@cache
def warn_once(log: logging.Logger, message: str) -> None:
    """Log a warning once per process."""
    log.warning("%s", message)


@cache
def notice_once(message: str, level: int = NOTICE) -> None:
    """Log an assumption of a reader once per process."""
    logging.getLogger(__name__).log(level, "%s", message)


def out_of_memory(error: BaseException | None) -> bool:
    """Return whether an unexplained error, or one of its causes, means that memory ran out."""
    while error is not None and not isinstance(error, SalsanextError):
        text = str(error).lower()
        is_named = isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError"
        if is_named or any(words in text for words in NO_MEMORY):
            return True
        error = error.__cause__ or error.__context__
    return False
