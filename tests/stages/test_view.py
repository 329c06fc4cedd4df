# SPDX-License-Identifier: MIT
import json
import os
import signal
import socket
import struct
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import replace
from http.client import HTTPConnection

import pytest
from evaluated import CAR, ROAD, SPACE, World
from scans import SMALL
from served import served

from salsanext_cli.errors import UsageError
from salsanext_cli.report.page.server import MAX_CONNECTIONS, _Handler
from salsanext_cli.results.manifest import Manifest, StageRecord
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.stages.report import report, view


@pytest.fixture
def world(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    world = World(tmp_path)
    for number in range(7):
        world.add(f"{number:06}", [CAR, ROAD, ROAD], [CAR, CAR, ROAD])
    return world


def asker(server):
    """Return a function that asks a server; it returns the status and the answer."""

    def ask(path, host=None, method="GET"):
        connection = HTTPConnection("127.0.0.1", server.server_port, timeout=20)
        path = path.replace("TOKEN", server.token)
        connection.request(method, path, headers={"Host": host} if host else {})
        found = connection.getresponse()
        return found.status, found.read().decode()

    return ask


@pytest.fixture
def ask(world):
    with view(world.out, query=ResultQuery(world.dataset)) as server, served(server):
        yield asker(server)


def test_every_scan_is_as_a_report_holds_it(world, ask):
    names = [f"08/{number:06}" for number in range(7)]
    page = report(world.out, query=ResultQuery(world.dataset), scans=names).page.read_text()
    for place, name in enumerate(names):
        status, text = ask(f"/cloud/TOKEN/{place}")
        cloud = json.loads(text)
        _, _, after = page.partition(f'id="cloud-{place}">')
        assert status == 200
        assert set(cloud.pop("scales")) == {"range", "intensity"}
        assert cloud == json.loads(after.partition("</script>")[0]) | {"reason": ""}
        assert cloud["name"] == name


def test_nothing_else_is_served_nor_to_other_pages_whatever_a_forwarded_port(ask):
    assert ask("/")[0] == 200
    assert ask("/?from=a-link")[0] == 200
    for place in ("7", "-1", "x", "", "../cloud/TOKEN/1", "9" * 5000):
        assert ask(f"/cloud/TOKEN/{place}")[0] == 404, place
    for path in ("/x", "/cloud", "/cloud/1"):
        assert ask(path)[0] == 404, path
    assert ask("/", method="POST")[0] == 501
    assert ask("/", host="[")[0] == 400
    # So is the page of an earlier server.
    status, text = ask("/cloud/another/1")
    assert status == 410
    assert "reload it" in json.loads(text)["error"]
    for host, status in (("localhost:9000", 200), ("127.0.0.1.evil.example", 403)):
        assert ask("/cloud/TOKEN/0", host)[0] == status, host


def test_results_made_anew_are_not_shown_as_those_of_the_start(world):
    record = StageRecord("predict", {"label_space": SPACE.to_dict(), "sensor": SMALL.to_dict()})
    Manifest(world.out).write(record)
    with view(world.out, query=ResultQuery(world.dataset)) as server, served(server):
        ask = asker(server)
        assert ask("/cloud/TOKEN/1")[0] == 200
        Manifest(world.out).write(replace(record, writes=("predictions",)))
        status, text = ask("/cloud/TOKEN/1")
    assert status == 500
    assert "start view again" in json.loads(text)["error"]


def test_a_browser_that_leaves_is_no_error(ask, world, capfd):
    with view(world.out, query=ResultQuery(world.dataset)) as server, served(server):
        connection = socket.create_connection(("127.0.0.1", server.server_port))
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        connection.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        connection.close()
        assert asker(server)("/")[0] == 200
    assert "Traceback" not in capfd.readouterr().err


def half_asked(server):
    """Return a connection over which half a request was sent."""
    connection = socket.create_connection(("127.0.0.1", server.server_port), timeout=20)
    connection.sendall(b"GET / HTTP/1.1\r\nHo")
    return connection


def test_half_requests_do_not_keep_others_out(world):
    with ExitStack() as stack, view(world.out, query=ResultQuery(world.dataset)) as server:
        stack.enter_context(served(server))
        halves = [stack.enter_context(half_asked(server)) for _ in range(300)]
        assert asker(server)("/")[0] == 200
        # All but the last ones are ended, and so are their threads.
        for connection in halves[: 300 - MAX_CONNECTIONS]:
            assert ended(connection)
        assert len(server._open) <= MAX_CONNECTIONS
        halves[-1].sendall(b"st: localhost\r\n\r\n")
        assert halves[-1].recv(12) == b"HTTP/1.0 200"


def test_a_request_that_does_not_come_is_not_waited_for(world, monkeypatch):
    monkeypatch.setattr(_Handler, "timeout", 0.1)
    with view(world.out, query=ResultQuery(world.dataset)) as server, served(server):
        with half_asked(server) as connection:
            assert ended(connection)
        assert asker(server)("/")[0] == 200


def ended(connection):
    """Say whether the other side has ended a connection, or does within its timeout."""
    try:
        return connection.recv(1) == b""
    except ConnectionError:
        return True


def test_a_scan_moved_away_is_an_answer_and_not_the_end(world, ask):
    (world.dataset / "sequences/08/velodyne/000003.bin").unlink()
    status, text = ask("/cloud/TOKEN/3")
    assert status == 500
    assert "000003" in json.loads(text)["error"]
    assert ask("/cloud/TOKEN/4")[0] == 200


def test_a_taken_port_is_one_line(world):
    first = view(world.out, query=ResultQuery(world.dataset))
    with first, pytest.raises(UsageError, match=r"--port .* in use .* 0 for any free one"):
        view(world.out, port=first.server_port, query=ResultQuery(world.dataset))


def test_it_ends_when_it_is_told_to(world):
    (world.dataset / "sequences/08/velodyne/000000.bin").write_bytes(b"damaged")
    command = [sys.executable, "-m", "salsanext_cli", "view", str(world.out), "--port", "0"]
    given = [*command, "--dataset", str(world.dataset), "--json"]
    ssh = {"SSH_CONNECTION": "10.0.0.1 5000 10.0.0.2 22"}
    with subprocess.Popen(
        given, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | ssh
    ) as run:
        try:
            assert run.stdout
            found = json.loads(run.stdout.readline())
            assert found["scans"] == 7
            assert found["url"].startswith("http://127.0.0.1:")
            run.send_signal(signal.SIGTERM)
            more, said = run.communicate(timeout=60)
        finally:
            run.kill()
    assert run.returncode == 1
    assert more == ""
    assert "Traceback" not in said
    assert "ssh -N -L" in said


def test_scans_that_cannot_be_read_and_scans_moved_away_are_told(world, caplog):
    scans = world.dataset / "sequences/08/velodyne"
    (scans / "000000.bin").write_bytes(b"damaged")
    (scans / "000004.bin").unlink()
    (scans / "000005.bin").unlink()
    server = view(world.out, query=ResultQuery(world.dataset))
    server.server_close()
    assert server.scans == 5
    assert [failure.scan.stem for failure in server.failures] == ["000000"]
    assert "2 scans with results not found any more and left out: 08/000004, 08/000005" in (
        caplog.text
    )
