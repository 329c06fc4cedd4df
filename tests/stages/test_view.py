# SPDX-License-Identifier: MIT
import json
import os
import signal
import subprocess
import sys
import threading
from http.client import HTTPConnection

import pytest
from evaluated import CAR, ROAD, World

from salsanext_cli.cli.view import _forwarding
from salsanext_cli.errors import NoInputError, UsageError
from salsanext_cli.stages.report import report
from salsanext_cli.stages.view import view


@pytest.fixture
def world(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    world = World(tmp_path)
    for number in range(7):
        world.add(f"{number:06}", [CAR, ROAD, ROAD], [CAR, CAR, ROAD])
    return world


@pytest.fixture
def ask(world):
    """Ask the server of a view; return the status and the answer."""
    with view(world.out, dataset=world.dataset) as server:
        serving = threading.Thread(target=server.serve_forever)
        serving.start()

        def answer(path, host=None, method="GET"):
            connection = HTTPConnection("127.0.0.1", server.server_port, timeout=20)
            connection.request(method, path, headers={"Host": host} if host else {})
            found = connection.getresponse()
            return found.status, found.read().decode()

        yield answer
        server.shutdown()
        serving.join()


def test_every_scan_is_as_a_report_holds_it(world, ask):
    names = [f"08/{number:06}" for number in range(7)]
    page = report(world.out, dataset=world.dataset, scans=names).page.read_text()
    for place, name in enumerate(names):
        status, text = ask(f"/cloud/{place}")
        cloud = json.loads(text)
        _, _, after = page.partition(f'id="cloud-{place}">')
        assert status == 200
        assert set(cloud.pop("scales")) == {"range", "intensity"}
        assert cloud == json.loads(after.partition("</script>")[0]) | {"reason": ""}
        assert cloud["name"] == name


def test_a_kind_that_few_scans_have_gets_a_scale(world, ask):
    world.put("uncertainty/entropy", "000001", [0.1, 0.5, 0.2])
    _, text = ask("/cloud/1")
    assert json.loads(text)["scales"]["entropy"]["high"] == pytest.approx(0.5, rel=0.02)


def test_nothing_else_is_served(ask):
    assert ask("/")[0] == 200
    assert ask("/?from=a-link")[0] == 200
    for path in ("/cloud/7", "/cloud/-1", "/cloud/x", "/cloud/", "/x", "/cloud/../cloud/1"):
        assert ask(path)[0] == 404, path
    assert ask("/", method="POST")[0] == 501


@pytest.mark.parametrize("host", ["localhost", "localhost:9000", "127.0.0.1"])
def test_a_forwarded_port_may_have_another_number(ask, host):
    assert ask("/cloud/0", host)[0] == 200


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8765", "127.0.0.1.evil.example"])
def test_pages_of_other_names_may_not_read_the_scans(ask, host):
    assert ask("/cloud/0", host)[0] == 403


def test_a_scan_moved_away_is_an_answer_and_not_the_end(world, ask):
    (world.dataset / "sequences/08/velodyne/000003.bin").unlink()
    status, text = ask("/cloud/3")
    assert status == 500
    assert "000003" in json.loads(text)["error"]
    assert ask("/cloud/4")[0] == 200


def test_a_taken_port_is_one_line(world):
    first = view(world.out, dataset=world.dataset)
    with first, pytest.raises(UsageError, match=r"--port .* in use .* 0 for any free one"):
        view(world.out, port=first.server_port, dataset=world.dataset)


def test_without_results_or_scans_there_is_nothing_to_view(world, tmp_path):
    with pytest.raises(NoInputError):
        view(tmp_path / "none")
    for scan in (world.dataset / "sequences/08/velodyne").iterdir():
        scan.write_bytes(b"damaged")
    with pytest.raises(NoInputError, match="no scan can be shown"):
        view(world.out, dataset=world.dataset)


@pytest.mark.parametrize(("ending", "status"), [(signal.SIGINT, 0), (signal.SIGTERM, 143)])
def test_it_ends_when_it_is_told_to(world, ending, status):
    command = [sys.executable, "-m", "salsanext_cli", "view", str(world.out), "--port", "0"]
    given = [*command, "--dataset", str(world.dataset), "--json"]
    ssh = {"SSH_CONNECTION": "10.0.0.1 5000 10.0.0.2 22"}
    with subprocess.Popen(
        given, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | ssh
    ) as run:
        assert run.stdout
        found = json.loads(run.stdout.readline())
        assert found["scans"] == 7
        assert found["url"].startswith("http://127.0.0.1:")
        run.send_signal(ending)
        _, said = run.communicate(timeout=60)
    assert run.returncode == status
    assert "Traceback" not in said
    assert "ssh -N -L" in said


def test_forwarding_names_what_ssh_needs(monkeypatch):
    monkeypatch.setattr("getpass.getuser", lambda: "ada")
    assert _forwarding(8765, "10.0.0.1 5000 10.0.0.2 2222") == (
        "ssh -N -L 8765:127.0.0.1:8765 -p 2222 ada@10.0.0.2"
    )
    assert _forwarding(8765, "") == ""
