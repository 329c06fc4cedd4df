# SPDX-License-Identifier: MIT
"""The wheels: what they contain, and that they work where only they are installed."""

import os
import subprocess
import sys
import tomllib
import venv
from dataclasses import dataclass
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
@pytest.mark.long
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
@pytest.mark.long
def test_the_wheel_holds_the_package_only(wheel):
    names = ZipFile(wheel).namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"salsanext_cli", "salsanext"}
    package = ROOT / "salsanext_cli"
    files = [path for path in package.rglob("*") if path.is_file() and path.suffix != ".pyc"]
    assert {str(path.relative_to(ROOT)) for path in files} <= set(names)
    assert "salsanext_cli/presets/weights/default.safetensors" in names
    assert wheel.stat().st_size < LARGEST_MB * 1e6


@dataclass(frozen=True, slots=True)
class Installation:
    """Environment in which only the wheel and its dependencies are installed."""

    scripts: Path
    folder: Path  # Working folder of the programs
    version: str  # Of the wheel

    def run(self, name: str, *words: object) -> str:
        """Run a program of the environment; return what it prints."""
        path = os.pathsep.join((str(self.scripts), os.environ["PATH"]))
        environment = {"PATH": path, "HOME": str(self.folder)}
        command = [self.scripts / name, *words]
        finished = subprocess.run(
            command, cwd=self.folder, env=environment, check=True, capture_output=True, text=True
        )
        return finished.stdout

    def install(self, *words: object) -> None:
        """Run ``pip install``."""
        self.run("python", "-m", "pip", "install", "-q", *words)


@pytest.fixture(scope="module")
def installation(wheel, tmp_path_factory):
    """Install the wheel into an environment of its own."""
    root = tmp_path_factory.mktemp("installation")
    venv.create(root / "env", with_pip=True)
    # "bin", or "Scripts" on Windows
    scripts = next(root.glob("env/[bS]*"))
    folder = root / "elsewhere"
    folder.mkdir()
    installed = Installation(scripts, folder, version=wheel.name.split("-")[1])
    # Python compiles what it imports, which is a quarter of the modules.
    installed.install("--no-compile", "-c", ROOT / "constraints.txt", wheel)
    return installed


@pytest.mark.slow
@pytest.mark.long
def test_the_wheel_has_its_version(installation):
    code = "import salsanext_cli as s; print(s.__version__)"
    assert installation.run("python", "-c", code).strip() == installation.version
    printed = installation.run("salsanext", "--version").strip()
    assert printed == f"salsanext {installation.version}"


@pytest.mark.slow
@pytest.mark.long
def test_the_wheel_runs_the_demonstration_and_predicts_its_scans(installation):
    installation.run("salsanext", "demo", "demo")
    assert (installation.folder / "demo/out/report.html").exists()
    (scans,) = installation.folder.glob("demo/data/sequences/*/velodyne")
    installation.run("salsanext", "predict", scans, "labels")
    results = installation.folder.glob("labels/sequences/*/predictions/*.label")
    assert {path.stem for path in results} == {path.stem for path in scans.glob("*.bin")}


@pytest.mark.slow
@pytest.mark.long
def test_the_extra_of_the_papers_adds_their_networks(wheels, wheel, installation):
    assert "pip install 'salsanext[paper]'" in installation.run("salsanext", "models")
    installation.install("--no-index", "--find-links", wheels, f"{wheel}[paper]")
    listed = installation.run("salsanext", "models")
    assert "salsanext[paper]" not in listed
    assert all(name in listed for name in PARAMETERS)
    counted = installation.run("python", "-c", COUNT.format(names=[*PARAMETERS])).split()
    assert [*map(int, counted)] == [*PARAMETERS.values()]
