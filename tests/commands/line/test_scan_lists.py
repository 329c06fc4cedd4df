# SPDX-License-Identifier: MIT
"""Commands take lists of scans, with the results of the same scans in folders."""

from command_line import only_json, subject
from scans import labels_below


def test_commands_take_a_list_of_scans(run, data, weights, tmp_path):
    network = ("--weights", weights, "--device", "cpu")
    names = sorted(str(path.relative_to(tmp_path.parent)) for path in data.rglob("*.bin"))
    listed = tmp_path.parent / f"{tmp_path.name}.txt"
    listed.write_text("\n".join(names))
    source = f"@{listed}"
    run("predict", data, tmp_path / "folder", *network, status=0)
    run("predict", source, tmp_path / "list", *network, status=0)
    assert labels_below(tmp_path / "list") == labels_below(tmp_path / "folder")
    assert len(labels_below(tmp_path / "list")) == len(names) == 2
    assert only_json(run("eval", tmp_path / "list", "--json"))["scans"] == 2
    assert only_json(run("inspect", source, "--json"))["total"]["scans"] == 2
    run("pick", source, tmp_path / "picked", "--count", 1, *network, status=0)


def test_a_list_is_no_output_folder(run, data, tmp_path):
    listed = tmp_path / "list.txt"
    listed.write_text(str(data))
    refused = run("predict", data, f"@{listed}")
    assert (refused.exit_code, subject(refused)) == (2, "OUT")
    refused = run("predict", f"@{listed}", tmp_path / "out", "--topic", "/points")
    assert (refused.exit_code, subject(refused)) == (2, "--topic")
