# SPDX-License-Identifier: MIT
"""Progress of a command in a log file."""

from salsanext_cli.commands.line.output.progress import ProgressLines


def test_a_log_file_gets_a_line_from_time_to_time(capsys):
    """The rate of a resumed training counts the steps of this run only."""
    now = 0.0
    lines = ProgressLines("predict", "scans", clock=lambda: now)
    for done in range(901, 1001):
        now += 3.0
        lines(done, 1000)
    err = capsys.readouterr().err.splitlines()
    assert err[0] == "predict: 910/1000 scans, 3.0 s/scan, 4 min 30 s left"
    assert len(err) == 9
    assert not any("1000/1000" in line for line in err)
    # Less than a minute is no 0 minutes.
    assert err[-1] == "predict: 990/1000 scans, 3.0 s/scan, 30.0 s left"


def test_the_time_left_does_not_count_the_start(capsys):
    """The first scan waits for the network, which takes 100 s; each further scan takes 3 s."""
    now = 0.0
    lines = ProgressLines("predict", "scans", clock=lambda: now)
    lines(0, 100)
    now = 100.0
    for done in range(1, 12):
        lines(done, 100)
        now += 3.0
    assert capsys.readouterr().err.splitlines() == [
        "predict: 1/100 scans",
        "predict: 11/100 scans, 3.0 s/scan, 4 min 27 s left",
    ]


def test_the_rate_is_that_of_scans_that_a_worker_reports_together(capsys):
    """Chunks of four scans arrive every 20 s, so that a scan takes 5 s."""
    now = 0.0
    lines = ProgressLines("predict", "scans", clock=lambda: now)
    for chunk in range(4):
        now += 20.0
        for done in range(4 * chunk + 1, 4 * chunk + 5):
            lines(done, 40)
    assert capsys.readouterr().err.splitlines() == [
        "predict: 5/40 scans, 5.0 s/scan, 2 min 55 s left",
        "predict: 13/40 scans, 5.0 s/scan, 2 min 15 s left",
    ]


def test_the_rate_of_a_second_run_does_not_count_the_first(capsys):
    """`pick` describes many scans, 1 s each, and then labels the few that it picked."""
    now = 0.0
    lines = ProgressLines("pick", "scans", clock=lambda: now)
    for total, seconds in ((100, 1.0), (10, 12.0)):
        lines(0, total)
        for done in range(1, total + 1):
            now += seconds
            lines(done, total)
    err = capsys.readouterr().err.splitlines()
    assert err[0] == "pick: 30/100 scans, 1.0 scans/s, 70.0 s left"
    assert err[-1] == "pick: 8/10 scans, 12.0 s/scan, 24.0 s left"
