# SPDX-License-Identifier: MIT
"""Values of `eval --fail-under` and `eval --fail-over`: limits on scores."""

import math

from salsanext_cli.commands.score_limits import GUARANTEE, SCORE_KINDS, ScoreKind, ScoreLimit
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.measures.counts import EVALUATED_KINDS
from salsanext_cli.core.texts import did_you_mean

FAIL_UNDER = "--fail-under"
FAIL_OVER = "--fail-over"
EXAMPLES = {
    FAIL_UNDER: "limits such as mean_iou=40,iou.person=20",
    FAIL_OVER: "limits such as ece=2,guarantee",
}


def option_of(kind: ScoreKind) -> str:
    """Return the option that sets a limit on a kind of score."""
    return FAIL_UNDER if kind.higher_is_better else FAIL_OVER


def parse_limits(text: str | None, option: str) -> tuple[ScoreLimit, ...]:
    """Return the limits in the value of an option, such as ``mean_iou=40,iou.person=20``."""
    if text is None:
        return ()
    limits: dict[str, ScoreLimit] = {}  # The last one of a name counts.
    for typed in map(str.strip, text.split(",")):
        name, equals, number = map(str.strip, typed.partition("="))
        _require_kind(name, typed, option)
        if name == GUARANTEE:
            if equals:
                expected = f"{GUARANTEE} without a number: `salsanext tune risk` set its limit"
                raise UsageError(option, f"is {typed}", expected)
            limit = math.nan
        else:
            limit = _number(name, number, option)
        limits[name] = ScoreLimit(name=name, limit=limit)
    return tuple(limits.values())


def _require_kind(name: str, typed: str, option: str) -> None:
    """Refuse a name that is no score, that lacks its class, or that belongs to the other option."""
    head, _, member = name.partition(".")
    kind = SCORE_KINDS.get(head)
    if kind is None:
        raise _unknown_score(name, option)
    has_member = bool(member)
    needs_member = bool(kind.member)
    if needs_member and not has_member:
        example = "person" if kind.member == "class" else "error"
        article = "a" if kind.member == "class" else "an"
        problem = f"{head} needs {article} {kind.member}"
        raise UsageError(option, problem, f"{head}.{example}, for example")
    if has_member and not needs_member:
        raise UsageError(option, f"no score is called {name!r}", head)
    if kind.member == "uncertainty" and member not in EVALUATED_KINDS:
        hint = did_you_mean(member, EVALUATED_KINDS)
        problem = f"no uncertainty is called {member!r}"
        raise UsageError(option, problem, ", ".join(EVALUATED_KINDS), hint)
    right_option = option_of(kind)
    if option != right_option:
        raise UsageError(option, f"does not apply to {name}", hint=f"use {right_option} {typed}")


def _unknown_score(name: str, option: str) -> UsageError:
    """Return the error of a name that is no score, with a similar one of the option."""
    head, _, member = name.partition(".")
    kinds = {score: kind for score, kind in SCORE_KINDS.items() if option_of(kind) == option}
    has_member = bool(member)
    similar = [score for score, kind in kinds.items() if bool(kind.member) == has_member]
    hint = did_you_mean(head, similar)
    return UsageError(option, f"no score is called {name!r}", ", ".join(kinds), hint)


def _number(name: str, text: str, option: str) -> float:
    """Return the limit of a score from its text, in its unit."""
    is_share = SCORE_KINDS[name.partition(".")[0]].unit == "%"
    try:
        limit = float(text.removesuffix("%") if is_share else text)
    except ValueError:
        raise UsageError(option, f"{text!r} is not a number", EXAMPLES[option]) from None
    most = 100 if is_share else math.inf
    if not 0 <= limit <= most or math.isinf(limit):
        expected = "0 to 100 %" if is_share else "a finite number of at least 0"
        raise UsageError(option, f"the limit of {name} is {text}", expected)
    if is_share and 0 < limit < 1 and not text.endswith("%"):
        hint = f"use {name}={100 * limit:g}, or {name}={text}% if this is meant"
        raise UsageError(option, f"{name}={text} looks like a share", "limits in %", hint)
    return limit
