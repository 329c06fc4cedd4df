# SPDX-License-Identifier: MIT
"""Messages that are logged once, and their levels."""

import logging

import numpy as np
import pytest
from scans import write_bin

from salsanext_cli import Scan
from salsanext_cli.core.notices import (
    NOTICE,
    demote_reader_notices,
    log_once,
    notice_once,
    warn_once,
)
from salsanext_cli.runs.scans.scan_search import find_scans


@pytest.fixture(autouse=True)
def forgotten(caplog):
    """Forget the messages of other tests."""
    caplog.set_level(logging.INFO)
    log_once.cache_clear()
    yield
    log_once.cache_clear()


def levels(caplog, text):
    return [record.levelno for record in caplog.records if text in record.getMessage()]


def test_a_message_is_logged_once(caplog):
    log = logging.getLogger("salsanext_cli.test")
    for _ in range(3):
        notice_once("columns are guesses")
        warn_once(log, "files cannot be locked")
    assert levels(caplog, "columns are guesses") == [NOTICE]
    assert levels(caplog, "files cannot be locked") == [logging.WARNING]


def test_assumptions_of_readers_are_details_where_an_earlier_command_stated_them(caplog):
    caplog.set_level(logging.INFO, "salsanext_cli")
    with demote_reader_notices():
        notice_once("read as rows")
        log_once("folder used", NOTICE)
    notice_once("read as columns")
    assert levels(caplog, "read as rows") == [logging.INFO]
    assert levels(caplog, "folder used") == [NOTICE]
    assert levels(caplog, "read as columns") == [NOTICE]


def test_which_folder_of_scans_is_used_is_never_a_detail(tmp_path, caplog):
    scan = Scan(np.ones((3, 3), np.float32), np.zeros(3, np.float32))
    write_bin(tmp_path / "recorded/lidar/000000.bin", scan)
    with demote_reader_notices():
        find_scans(tmp_path)
    assert levels(caplog, "recorded/lidar") == [NOTICE]
