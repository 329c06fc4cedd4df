# SPDX-License-Identifier: MIT
import logging
import pickle
import re
from pathlib import Path

from salsanext_cli.cli.console import Output
from salsanext_cli.errors import (
    FormatError,
    OutputError,
    SalsanextError,
    escaped,
    printable,
)


def test_errors_are_their_parts_and_survive_the_way_from_a_worker_process():
    assert str(SalsanextError("a", "b", "c", "d")) == "a · b · expected c · d"
    assert str(SalsanextError("a", "b", remedy="d")) == "a · b · d"
    error = OutputError("out", "disk full", remedy="free some space")
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is OutputError
    assert vars(copy) == vars(error)


def test_every_kind_has_its_own_documented_code():
    kinds = [SalsanextError, *SalsanextError.__subclasses__()]
    page = (Path(__file__).parents[1] / "docs/json.md").read_text("utf-8")
    table = page.partition("| code | meaning |")[2].partition("\n\n")[0]
    codes = set(re.findall(r"`([a-z-]+)`", table)) - {"interrupted", "terminated"}
    assert codes == {kind.code for kind in kinds}
    assert len(codes) == len(kinds)


def test_control_characters_in_names_of_files_are_escaped():
    said = str(FormatError("a\nerror: b\x1b]0;x\x07.bin", "cut\x9b off", remedy="größer"))
    assert said == "a\\x0aerror: b\\x1b]0;x\\x07.bin · cut\\x9b off · größer"
    assert printable("ä\t\x7f") == "ä\\x09\\x7f"
    assert printable("a\u202enib.bin\u2028\u2066") == "a\\u202enib.bin\\u2028\\u2066"


def test_data_for_other_programs_is_text():
    data = {"a\udcff": ["b\udc80\n", ("ü", 1)], "deep": {"c": None, 3: 0.5}}
    expected = {"a\\xff": ["b\\x80\n", ["ü", 1]], "deep": {"c": None, 3: 0.5}}
    assert escaped(data) == expected


def test_commands_log_and_say_printable_text(capsys, monkeypatch):
    logger = logging.getLogger("salsanext_cli")
    monkeypatch.setattr(logger, "handlers", [])
    monkeypatch.setattr(logger, "level", logger.level)
    output = Output(verbose=True)
    logger.info("reading %s", "a\x1b[2J.bin")
    output.say("→ b\x07\nc")
    assert capsys.readouterr().err == "reading a\\x1b[2J.bin\n→ b\\x07\\x0ac\n"
