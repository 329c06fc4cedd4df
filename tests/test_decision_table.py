# SPDX-License-Identifier: MIT
"""The tables of the tutorial that lead to a decision are the rules of the package."""

import re
from pathlib import Path

from salsanext_cli.core.measures.decision import CODES, DOUBTFUL, LEVELS, MOST, Decision
from salsanext_cli.core.measures.label_gains import gains_of_trials

PAGE = Path(__file__).parents[1] / "docs/tutorials/own-sensor.md"
SECTION = PAGE.read_text("utf-8").partition("## 6. Use, label, or stop\n")[2]
WORDS = {
    Decision.USE: "use the labels",
    Decision.COARSE: "use coarse classes",
    Decision.LABEL_TEN: "label ten scans",
    Decision.LABEL_FORTY: "label forty scans",
    Decision.CORRECT: "correct the scans first",
    Decision.UNSUITED: "stop",
}
"""Beginning of the advice in the tables."""


def rows() -> list[list[str]]:
    """Return the cells of the rows of both tables, without headings."""
    lines = [line for line in SECTION.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def decision_of(advice: str) -> Decision:
    (decision,) = (key for key, words in WORDS.items() if advice.startswith(words))
    return decision


def percentage(cell: str, default: float) -> float:
    number = re.match(r"(\d+) % or (more|less)$", cell)
    return int(number[1]) / 100 if number else default


def test_the_limits_are_those_of_the_levels_in_their_order():
    limits = [cells for cells in rows() if len(cells) == 3 and cells[0] != "estimated accuracy"]
    shown = [
        (decision_of(do), percentage(accuracy, 0.0), percentage(rejected, 1.0))
        for accuracy, rejected, do in limits
    ]
    assert shown == [
        (level.decision, level.least_accuracy, level.most_doubtful) for level in LEVELS
    ]
    assert f"rejected at {100 * DOUBTFUL:.0f} %, of the points with a label" in SECTION
    assert f"`--reject {DOUBTFUL}`" in SECTION


def test_the_warnings_are_those_of_each_decision():
    shown = {
        decision_of(do): tuple(re.findall(r"`([a-z-]+)`", codes))
        for codes, do in (cells for cells in rows() if len(cells) == 2)
        if codes != "warning"
    }
    assert shown == CODES
    assert MOST == 0.5
    assert "more than half of the scans" in SECTION


def test_every_warning_is_in_the_table_or_in_the_sentence_after_it():
    page = PAGE.parents[1] / "reference/warnings.md"
    known = set(re.findall(r"^\| `([a-z-]+)` \|", page.read_text("utf-8"), re.MULTILINE))
    deciding = {code for codes in CODES.values() for code in codes}
    (others,) = re.findall(
        r"Other warnings do not change the decision: (.*?)\.\n", SECTION, re.DOTALL
    )
    named = set(re.findall(r"`([a-z-]+)`", others)) - {"fuse"}
    assert named == known - deciding
    assert deciding < known


def test_the_gains_quoted_are_those_of_the_trials():
    text = " ".join(SECTION.split())
    many, few = gains_of_trials(None)
    for gains in (many, few):
        scans = [trial.scans for trial in gains.trials]
        assert f"{min(scans)} to {max(scans)} labelled scans" in text
        quoted = f"{gains.worst:.1f} to {gains.best:.1f} percentage points"
        assert quoted in text
        assert f"(median {gains.median:.1f})" in text
    assert {trial.version for trial in many.trials} == {5}
    assert {trial.version for trial in few.trials} == {0, 2}
    same = sum(trial.same_drive for trial in few.trials)
    assert (len(many.trials), len(few.trials), same) == (4, 7, 3)
    assert "Four trials of weights version 5" in text
    assert "Seven trials of versions 0 and 2" in text
    assert "Three of these seven scored the drive" in text
