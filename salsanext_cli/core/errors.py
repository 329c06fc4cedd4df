# SPDX-License-Identifier: MIT
"""Errors that the user can correct.

The library raises them; only the command line prints them and chooses the exit status. Any other
exception is a bug and keeps its traceback.
"""

from typing import ClassVar

from salsanext_cli.core.texts import printable, with_hint


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
        text = ": ".join(filter(None, (self.subject, self.problem)))
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
