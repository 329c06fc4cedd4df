# SPDX-License-Identifier: MIT
"""The wheels: what they contain, and that they work where only they are installed."""

import os
import subprocess
import sys
import tomllib
import venv
from pathlib import Path
from zipfile import ZipFile

import pytest

from tools.lowest import OTHERS, lowest

ROOT = Path(__file__).parents[1]
PAPER = ROOT / "examples/paper_networks"
PARAMETERS = {"salsanext-v1": 23_262_548, "rangenet53": 50_377_364}
"""Parameters of networks of the papers with 20 classes."""
COUNT = """
from salsanext_cli.core.network.registry import build
for name in {names}:
    print(sum(parameter.numel() for parameter in build({{"name": name}}).parameters()))
"""
LARGEST_MB = 20


def test_every_dependency_has_a_lowest_version_that_is_pinned():
    lines = (ROOT / "constraints-lowest.txt").read_text("utf-8").splitlines()
    pinned = dict(line.split("==") for line in lines if not line.startswith("#"))
    lowest_versions = lowest(ROOT / "pyproject.toml")
    assert pinned == lowest_versions | OTHERS
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    names = {text.partition(">=")[0].partition("[")[0] for text in project["dependencies"]}
    assert all(">=" in text for text in project["dependencies"])
    # The extras have dependencies of their own.
    assert names <= lowest_versions.keys()


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    """Return the folder with the wheels of the package and of the networks of the papers."""
    if given := os.environ.get("SALSANEXT_WHEELS"):
        return ROOT / given
    folder = tmp_path_factory.mktemp("dist")
    for source in (ROOT, PAPER):
        build = [sys.executable, "-m", "build", "--wheel", "--outdir", folder, source]
        subprocess.run(build, check=True)
    return folder


@pytest.fixture(scope="module")
def wheel(wheels):
    (path,) = wheels.glob("salsanext-*.whl")
    return path


@pytest.mark.slow
def test_the_wheel_of_the_papers_holds_the_networks_and_has_the_version(wheels, wheel):
    (path,) = wheels.glob("salsanext_paper_networks-*.whl")
    assert path.name.split("-")[1] == wheel.name.split("-")[1]
    with ZipFile(path) as archive:
        names = archive.namelist()
        (points,) = [name for name in names if name.endswith("entry_points.txt")]
        listed = archive.read(points).decode()
    assert {name.split("/")[0].split("-")[0] for name in names} == {
        "paper_networks",
        "salsanext_paper_networks",
    }
    files = [file for file in (PAPER / "paper_networks").iterdir() if file.suffix != ".pyc"]
    assert {f"paper_networks/{file.name}" for file in files if file.is_file()} <= {*names}
    assert any(name.endswith("/LICENSE") for name in names)
    for name in PARAMETERS:
        assert f"\n{name} = " in listed


@pytest.mark.slow
def test_the_wheel_holds_the_package_only(wheel):
    names = ZipFile(wheel).namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"salsanext_cli", "salsanext"}
    package = ROOT / "salsanext_cli"
    files = [path for path in package.rglob("*") if path.is_file() and path.suffix != ".pyc"]
    assert {str(path.relative_to(ROOT)) for path in files} <= set(names)
    assert "salsanext_cli/presets/weights/default.safetensors" in names
    assert wheel.stat().st_size < LARGEST_MB * 1e6


@pytest.mark.slow
def test_the_wheel_works_where_nothing_else_is(wheels, wheel, tmp_path):
    """The demonstration, `predict` on its scans, and the extra `paper`, from another folder."""
    venv.create(tmp_path / "env", with_pip=True)
    # "bin", or "Scripts" on Windows
    scripts = next(tmp_path.glob("env/[bS]*"))
    path = os.pathsep.join((str(scripts), os.environ["PATH"]))
    environment = {"PATH": path, "HOME": str(tmp_path)}
    folder = tmp_path / "elsewhere"
    folder.mkdir()

    def run(*words):
        options = {"check": True, "capture_output": True, "text": True}
        return subprocess.run(words, cwd=folder, env=environment, **options).stdout

    run(scripts / "python", "-m", "pip", "install", "-q", "-c", ROOT / "constraints.txt", wheel)
    code = "import salsanext_cli as s; print(s.__version__)"
    version = run(scripts / "python", "-c", code).strip()
    assert version == wheel.name.split("-")[1]
    assert run(scripts / "salsanext", "--version").strip() == f"salsanext {version}"
    run(scripts / "salsanext", "demo", "demo")
    assert (folder / "demo/out/report.html").exists()
    (scans,) = folder.glob("demo/data/sequences/*/velodyne")
    run(scripts / "salsanext", "predict", scans, "labels")
    labels = {path.stem for path in folder.glob("labels/sequences/*/predictions/*.label")}
    assert labels == {path.stem for path in scans.glob("*.bin")}
    assert "pip install 'salsanext[paper]'" in run(scripts / "salsanext", "models")
    offline = ("-q", "--no-index", "--find-links", wheels)
    run(scripts / "python", "-m", "pip", "install", *offline, f"{wheel}[paper]")
    listed = run(scripts / "salsanext", "models")
    assert "salsanext[paper]" not in listed
    assert all(name in listed for name in PARAMETERS)
    counted = run(scripts / "python", "-c", COUNT.format(names=[*PARAMETERS])).split()
    assert [*map(int, counted)] == [*PARAMETERS.values()]
