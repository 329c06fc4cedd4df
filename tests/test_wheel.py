# SPDX-License-Identifier: MIT
"""The wheel: what it contains, and that it works where only it is installed."""

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
def wheel(tmp_path_factory):
    if given := os.environ.get("SALSANEXT_WHEEL"):
        return ROOT / given
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run([sys.executable, "-m", "build", "--wheel", "--outdir", folder, ROOT], check=True)
    (path,) = folder.glob("*.whl")
    return path


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
def test_the_wheel_works_where_nothing_else_is(wheel, tmp_path):
    """The demonstration, and `predict` on its scans, from another folder."""
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
