# SPDX-License-Identifier: MIT
"""All codes of warnings are members of one registry, which checks, estimate and page agree with."""

import ast
import json
import pickle
import re

import pytest
from package_trees import MODULES, PACKAGE, name_of, nodes_of, tree_of

from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.measures.decision import CODES
from salsanext_cli.core.measures.expected_accuracy import OF_RUN, WITHHELD_FOR

PAGE = (PACKAGE.parent / "docs/reference/warnings.md").read_text("utf-8")
REGISTRY = PACKAGE / "core/checks/warning_codes.py"
OTHERS = {name_of(module): module for module in MODULES if module != REGISTRY}
CODES_OF_WARNINGS = {"Finding", "ScanWarning"}
"""Records whose first argument is a code."""


def test_the_table_of_the_page_is_the_registry():
    rows = re.findall(r"^\| `([a-z-]+)` \| (.+?) \|", PAGE.partition("\n## ")[0], re.MULTILINE)
    assert rows == [(code.value, code.meaning) for code in WarningCode]


def test_the_page_names_the_codes_that_withhold_no_estimate():
    sentence = re.search(r"estimates no accuracy for the scan, except with (.+?)\. ", PAGE, re.S)[1]
    allowed = [code.value for code in WarningCode if not code.withholds_estimate]
    assert re.findall(r"`([a-z-]+)`", sentence) == allowed


def test_an_estimate_is_withheld_and_a_decision_made_for_the_same_codes():
    withheld = {code for code in WarningCode if code.withholds_estimate}
    assert set(WITHHELD_FOR) == withheld
    assert {*OF_RUN} <= withheld
    assert sorted(code for codes in CODES.values() for code in codes) == sorted(withheld)


@pytest.fixture(scope="module")
def named_codes():
    """Return the names of the codes that modules take from the registry."""
    return {
        node.attr
        for name, module in OTHERS.items()
        if "measures" not in name
        for node in nodes_of(tree_of(module))
        if isinstance(node, ast.Attribute) and getattr(node.value, "id", "") == "WarningCode"
    }


@pytest.mark.parametrize("code", WarningCode)
def test_a_check_gives_each_code(named_codes, code):
    """A code that nothing gives would be a row about nothing."""
    assert code.name in named_codes


def test_no_warning_has_a_code_beside_the_registry():
    spelled = [
        f"{name}:{node.lineno}"
        for name, module in OTHERS.items()
        for node in nodes_of(tree_of(module))
        if isinstance(node, ast.Call) and node.args
        if getattr(node.func, "id", "") in CODES_OF_WARNINGS
        if isinstance(node.args[0], ast.Constant)
    ]
    assert spelled == []


@pytest.mark.parametrize("code", WarningCode)
def test_a_code_is_its_text_in_records_and_between_processes(code):
    assert {code: 1} == {code.value: 1}
    assert json.loads(json.dumps([code, {code: 0}])) == [code.value, {code.value: 0}]
    assert f"{code}" == str(code) == code.value
    assert pickle.loads(pickle.dumps(code)) is code
