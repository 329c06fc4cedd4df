# SPDX-License-Identifier: MIT
"""Text of messages: numbers with nouns, shortened values, escaped names, likely words."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

MAX_LISTED_NAMES = 3  # Files or scans that a message names
LIKE = 0.6  # Least similarity (`difflib`) of a typed word and the word that a hint suggests
SHOWN_CHARACTERS = 100  # Longest text of a wrong value in an error
UNDECODED = {code: f"\\x{code & 0xFF:02x}" for code in range(0xDC80, 0xDD00)}
"""Escapes of the bytes in file names that are not text, as Python decodes them."""
CONTROL = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160))}
DIRECTION = {0x061C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A)}
"""Characters that end lines or change the direction of text, and so disguise a name."""
ESCAPES = UNDECODED | CONTROL | {code: f"\\u{code:04x}" for code in DIRECTION}
HINT = "\nhint: "  # Between a message and its hint


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
    """Return a share in percent, such as "72.7 %".

    Parameters
    ----------
    share : float
        Share, 0…1.
    decimals : int
        Number of decimals.
    figures : int, optional
        Number of significant figures, instead of decimals.

    Returns
    -------
    str
    """
    number = 100 * share
    if figures is None:
        return f"{number:.{decimals}f} %"
    rounded = float(f"{number:.{figures}g}")
    return f"{rounded:g} %"  # Without an exponent, which 100 with two figures would have


def first_few(names: Sequence[object]) -> str:
    """Return the first `MAX_LISTED_NAMES` names and the number of further ones."""
    more = len(names) - MAX_LISTED_NAMES
    listed = ", ".join(map(str, names[:MAX_LISTED_NAMES]))
    return f"{listed} and {more} more" if more > 0 else listed


def nearest(word: str, words: Iterable[str], likeness: float = LIKE) -> str:
    """Return the word that was probably meant, also by its initials.

    Parameters
    ----------
    word : str
        Word as it was typed.
    words : iterable of str
        Possible words.
    likeness : float
        Least likeness of the word, from 0 to 1 for an equal one.

    Returns
    -------
    str
        One of the possible words; empty if none is near.
    """
    from difflib import get_close_matches  # Only errors need it

    by_lower_case = {candidate.lower(): candidate for candidate in words}
    typed = word.strip().lower()
    close = get_close_matches(typed, by_lower_case, 1, likeness)
    if close:
        return by_lower_case[close[0]]
    for name, candidate in by_lower_case.items():
        initials = "".join(piece[:1] for piece in name.replace("-", "_").split("_"))
        if len(typed) > 1 and (typed == initials or name.startswith(typed)):
            return candidate
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
    """Return the text of a value, shortened to a length in characters."""
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
