# SPDX-License-Identifier: MIT
"""Documentation: commands parse, code runs, names exist."""

import hashlib
import json
import pydoc
import re
import runpy
import shlex
import shutil
import sys
import threading
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import guide
import numpy as np
import prepared
import pytest
import refresh
import yaml
from command_line import called, every_command, parsed, root
from pictures import pipeline
from quick_streets import record
from scans import (
    SMALL,
    make_scan,
    salsanext_of,
    write_array,
    write_bin,
    write_sequence,
    write_weights,
)
from shallow_network import SHALLOW

import salsanext_cli
from salsanext_cli import LabelSpace, Sensor, label_space, load_network, project, read_scan
from salsanext_cli.commands.line.app import COMMANDS
from salsanext_cli.commands.line.options.options_file import COMMANDS_WITH_FILE
from salsanext_cli.commands.line.values.shard_option import shard_of_kubernetes
from salsanext_cli.commands.stages import predict as stage
from salsanext_cli.commands.stages import synth
from salsanext_cli.commands.stages.export_onnx import export_onnx
from salsanext_cli.core.sensors import sensor as sensors
from salsanext_cli.io.formats import SCAN_SUFFIXES
from salsanext_cli.io.weights.card_file import default_weights
from salsanext_cli.runs.loop.run_options import Shard
from salsanext_cli.runs.results.folder_names import SUFFIX_OF_FOLDER
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training import recipe
from salsanext_cli.training.recipe import Recipe

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [*guide.PAGES, ROOT / "CONTRIBUTING.md"]
NAMES = list(every_command())
WORDS = {word for commands in COMMANDS.values() for word in commands}
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
RUN = (
    "../README.md",
    "start/install.md",
    *refresh.CAPTURED,
    "how-to/sensors.md",
    "how-to/classes.md",
    "how-to/look-at-results.md",
    "how-to/point-clouds.md",
    "how-to/fuse.md",
    "how-to/labels.md",
    "how-to/train.md",
    "how-to/deploy.md",
    "reference/metrics.md",
)
"""Pages whose commands are run, in the folder of `prepared.py`."""
BUILT = DOCS / "example/report.html"
"""Live example of a report, which `make docs` builds before the site."""
INLINE = re.compile(r"`((?:time )?salsanext [^`]+)`")
LINK = re.compile(r"\]\(([^)\s]+)\)")


def text_of(name: str) -> str:
    return (ROOT / name).read_text("utf-8")


def blocks(page: Path, language: str) -> list[str]:
    """Return the fenced blocks of a language."""
    return [body for kind, body in BLOCK.findall(page.read_text("utf-8")) if kind == language]


def command_lines(page: Path) -> Iterator[str]:
    """Yield every call of the command line, in blocks and in running text."""
    for body in blocks(page, "sh"):
        for line in body.replace("\\\n", " ").splitlines():
            yield line.strip()
    for line in INLINE.findall(BLOCK.sub("", page.read_text("utf-8"))):
        yield " ".join(line.split()).removeprefix("time ")


def parse(arguments: list[str]) -> None:
    """Parse a command line, options, values and all, without running it."""
    command = root()
    context, name, rest = None, "salsanext", arguments
    while hasattr(command, "commands") and rest[0] not in ("--version", "-V"):
        context = command.make_context(name, list(rest), parent=context, resilient_parsing=True)
        name, command, rest = command.resolve_command(context, list(rest))
        assert command, f"no such command: {' '.join(arguments)}"
    command.make_context(name, rest, parent=context)


def test_every_command_line_parses(monkeypatch):
    monkeypatch.delenv("SALSANEXT_OUT", raising=False)
    lines = {line for page in PAGES for line in command_lines(page)}
    for line in sorted(line for line in lines if line.startswith("salsanext ")):
        arguments = shlex.split(line, comments=True)[1:]
        if len(arguments) == 1:
            assert arguments[0] in WORDS | {"--help", "--version", "--install-completion"}
        elif not {"COMMAND", "[OPTIONS]"} & {*arguments}:
            parse(arguments)


def test_every_command_is_documented_and_its_help_is_a_sentence_and_an_example():
    pages = [page.read_text("utf-8") for page in DOCS.rglob("*.md") if page.name != "cli.md"]
    for name in NAMES:
        assert f"### salsanext {name}\n" in text_of("docs/cli.md")
        assert f"`{name}`" in text_of("README.md"), name
        assert any(f"salsanext {name} " in page for page in pages), name
        what, _, example = parsed(name).help.partition("Example: ")
        assert what.strip().endswith("."), name
        assert example.startswith(f"salsanext {name}")
        assert all(p.help for p in parsed(name).params), name


def test_the_command_reference_is_current_whatever_the_terminal(monkeypatch):
    for variable, value in {"COLUMNS": "40", "TERMINAL_WIDTH": "40", "FORCE_COLOR": "1"}.items():
        monkeypatch.setenv(variable, value)
    page = runpy.run_path(str(DOCS / "reference.py"))["page"]()
    assert text_of("docs/cli.md") == page, "run `make docs`"


def test_the_picture_of_the_pipeline_is_current(tmp_path):
    pipeline.draw(tmp_path, tmp_path / "pipeline.svg")
    assert text_of("docs/images/pipeline.svg") == (tmp_path / "pipeline.svg").read_text("utf-8")
    named = {box.text for box in pipeline.BOXES.values() if box.colours == pipeline.COMMAND}
    assert set(", ".join(named).split(", ")) <= {*NAMES}


@pytest.fixture
def scans_here(tmp_path, monkeypatch) -> None:
    """Make the current folder one with the scans that the Python examples name."""
    write_bin(tmp_path / "000000.bin", make_scan())
    write_sequence(tmp_path / "seq", ["000000", "000001"])
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def weights_here(scans_here, take_by_default) -> Iterator[None]:
    """Have weights of two levels in the current folder, which are also the default ones."""
    with salsanext_of(**SHALLOW):
        take_by_default(write_weights(Path("weights.safetensors").absolute()))
        yield


def names_of_blocks(page: Path) -> dict[str, Any]:
    """Run the Python blocks of a page, one after the other; return what they have named."""
    names: dict[str, Any] = {}
    for number, body in enumerate(blocks(page, "python")):
        exec(compile(body, f"{page.name}, block {number}", "exec"), names)
    return names


@pytest.mark.usefixtures("weights_here")
def test_what_is_deployed_computes_what_predict_does():
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    export_onnx(Path("weights.safetensors"), Path("model.onnx"))
    scan = read_scan("000000.bin")
    image = salsanext_cli.project(scan, SMALL)
    write_array(Path("out/sequences/00/range/000000.npy"), image.channels)
    expected = load_network("weights.safetensors", "cpu").logits(image)
    names = names_of_blocks(DOCS / "how-to/deploy.md")
    assert np.abs(names["logits"][0] - expected).max() < 1e-3
    assert np.array_equal(names["labels"], expected.argmax(0))


@pytest.mark.usefixtures("scans_here")
def test_the_python_of_the_readme_runs_with_the_default_weights():
    names = names_of_blocks(ROOT / "README.md")
    assert (names["labels"].shape, names["labels"].dtype) == ((len(names["scan"]),), np.uint8)
    assert abs(names["probabilities"].sum(axis=1) - 1).max() < 1e-5


@pytest.mark.usefixtures("weights_here", "undrawn")
def test_the_python_of_its_page_runs():
    names = names_of_blocks(DOCS / "how-to/python.md")
    assert (names["labels"].shape, names["labels"].dtype) == ((len(names["scan"]),), np.uint8)
    assert abs(names["probabilities"].sum(axis=0) - 1).max() < 1e-5
    assert (names["outcome"].done, names["outcome"].failures) == (2, ())
    assert names["evaluation"].counts.scans == 2


def has_pods_that_find_their_scans(body: str) -> bool:
    """Return whether a job has a pod for each shard, or all pods of a cluster have one volume."""
    resource = yaml.safe_load(body)
    spec = resource["spec"]
    if resource["kind"] == "RayCluster":
        head = spec["headGroupSpec"]
        pods = [group["template"]["spec"] for group in (head, *spec["workerGroupSpecs"])]
        first = pods[0]
        shared = {"image", "volumeMounts"}
        return head["rayStartParams"]["num-cpus"] == "0" and all(
            pod["volumes"] == first["volumes"]
            and all(pod["containers"][0][key] == first["containers"][0][key] for key in shared)
            for pod in pods
        )
    (container,) = spec["template"]["spec"]["containers"]
    variables = {variable["name"]: variable["value"] for variable in container["env"]}
    shard = shard_of_kubernetes({"JOB_COMPLETION_INDEX": "0", **variables})
    return shard == Shard(1, spec["completions"])


def has_only_options(body: str) -> bool:
    """Return whether all keys of an options file are options of commands that read it."""
    content = tomllib.loads(body)
    tables = {key: value for key, value in content.items() if isinstance(value, dict)}
    names = {
        name: {option for p in parsed(name).params for option in p.opts}
        for name in COMMANDS_WITH_FILE
    }
    in_tables = all(f"--{key}" in names[name] for name in tables for key in tables[name])
    top = [key for key in content if key not in tables]
    return in_tables and all(
        any(f"--{key}" in names[name] for name in COMMANDS_WITH_FILE) for key in top
    )


READERS: dict[tuple[str, str], Callable[[str], object]] = {
    ("sensors.md", "toml"): lambda body: Sensor.from_dict(
        SMALL.to_dict() | tomllib.loads(body), "sensors.md"
    ),
    ("train.md", "toml"): lambda body: Recipe.from_dict(tomllib.loads(body)),
    ("train.md", "yaml"): lambda body: LabelSpace.from_dict(
        label_space().to_dict() | yaml.safe_load(body)
    ),
    ("survey.md", "yaml"): lambda body: LabelSpace.from_dict(
        label_space().to_dict() | yaml.safe_load(body)
    ),
    ("classes.md", "yaml"): lambda body: LabelSpace.from_dict(yaml.safe_load(body)),
    ("automate.md", "json"): json.loads,
    ("automate.md", "toml"): has_only_options,
    ("json.md", "json"): json.loads,
    ("many-scans.md", "yaml"): has_pods_that_find_their_scans,
    ("plug-ins.md", "toml"): lambda body: tomllib.loads(body)["project"]["entry-points"],
}


def test_the_settings_shown_are_accepted():
    shown = [
        (page.name, language, body)
        for page in PAGES
        for language in ("toml", "yaml", "json")
        for body in blocks(page, language)
    ]
    assert {(name, language) for name, language, _ in shown} == set(READERS)
    for name, language, body in shown:
        assert READERS[name, language](body)


def test_the_sensors_shown_are_the_presets():
    rows = re.findall(r"^\| `(\S+)` \| (\S+)° \| (\S+)° \| (\d+)×(\d+) \| (\S+) \| (\d+) cm \|$",
                      text_of("docs/how-to/sensors.md"), re.MULTILINE)  # fmt: skip
    shown = {
        name: (float(up), float(down), int(height), int(width), float(scale), int(noise) / 100)
        for name, up, down, height, width, scale, noise in rows
    }
    assert shown == {
        name: (s.fov_up, s.fov_down, s.height, s.width, s.intensity_scale, s.range_noise)
        for name, s in sensors.presets().items()
    }


def test_the_recipes_shown_are_the_presets_and_their_defaults():
    named = text_of("docs/how-to/train.md").partition("## Memory and speed")[0]
    keys = text_of("docs/reference/recipe-keys.md").partition("## Augmentations")[0]
    listed_recipes = re.findall(r"^\| `([\w-]+)` \|", named.split("## Recipes")[1], re.MULTILINE)
    assert sorted(listed_recipes) == sorted(recipe.presets())
    shown: dict[str, Any] = {}
    for names, values in re.findall(r"^\| (`.+?`) \| (.+?) \|", keys, re.MULTILINE):
        listed = re.findall(r"`(\w+)`", names)
        defaults = [json.loads(value.strip("`")) for value in values.split(", ")]
        shown |= dict(zip(listed, defaults * len(listed) if len(defaults) == 1 else defaults,
                          strict=False))  # fmt: skip
    assert shown == Recipe().to_dict()


def test_every_kind_of_file_is_described():
    page = text_of("docs/reference/files.md")
    for suffix in SCAN_SUFFIXES:
        assert f"| `{suffix}` |" in page
    for folder in SUFFIX_OF_FOLDER:
        kind, slash, _ = folder.partition("/")
        name = f"{kind}/<{'kind' if kind == 'uncertainty' else 'colour'}>" if slash else folder
        assert f"| `{name}/` | `{SUFFIX_OF_FOLDER[folder]}`" in page


@pytest.mark.parametrize("page", ["reference/paper-to-code.md", "how-to/python.md"])
def test_every_name_in_the_tables_exists(page):
    tops = {path.name.removesuffix(".py") for path in (ROOT / "salsanext_cli").iterdir()}
    rows = [line for line in text_of(f"docs/{page}").splitlines() if line.startswith("|")]
    dotted = {n for row in rows for n in re.findall(r"`([a-z_]+(?:\.\w+)+)`", row)}
    names = {name for name in dotted if name.split(".")[0] in tops}
    assert len(names) > 10
    for name in names:
        assert pydoc.locate(f"salsanext_cli.{name}"), name
    if page == "how-to/python.md":
        assert len(names) == len(NAMES)


HELPERS = {
    "io/formats/evidence/file_kinds.py",
    "io/formats/kitti_labels.py",
    "io/formats/columns.py",
    "io/formats/evidence/column_evidence.py",
    "io/formats/evidence/column_measures.py",
    "io/formats/evidence/plane_evidence.py",
    "io/formats/evidence/value_types.py",
    "core/checks/check_sample.py",
    "core/geometry/directions.py",
    "core/geometry/evenness.py",
    "core/geometry/ground.py",
    "core/geometry/point_sample.py",
    "core/geometry/row_gaps.py",
    "core/geometry/sectors.py",
    "core/geometry/scan_traits.py",
    "core/geometry/sensor_frame.py",
    "core/checks/finding.py",
    "core/checks/further_returns.py",
    "core/checks/label_checks.py",
    "core/checks/place_checks.py",
    "core/checks/scan_structure.py",
    "core/checks/structure_checks.py",
    "core/checks/training_checks.py",
    "core/engines/backend.py",
    "core/engines/batches.py",
    "core/engines/device.py",
    "core/engines/graphs.py",
}
"""Files of these parts that the steps of a scan call."""


@pytest.mark.usefixtures("weights_here")
def test_a_scan_passes_through_the_documented_files_in_order(world, monkeypatch):
    network = replace(world.network, weights=Path("weights.safetensors"), engine="openvino")
    package = f"{ROOT / 'salsanext_cli'}/"
    prepare, visited = stage.PredictJob.prepare, dict[str, None]()

    def note(frame, event: str, _: object) -> None:
        path = frame.f_code.co_filename
        if event == "call" and path.startswith(package):
            visited[path.removeprefix(package)] = None

    def prepare_first(job, file):
        visited.clear()
        return prepare(job, file)

    # A graph that is compiled for the first time is written to the cache.
    network.load().probabilities(project(make_scan(), SMALL))
    monkeypatch.setattr(stage.PredictJob, "prepare", prepare_first)
    threading.setprofile(note)
    sys.setprofile(note)
    try:
        stage.predict_scans(world.scan(), world.out, settings=network)
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    section = text_of("docs/project/development.md").partition("## How a scan is processed")[2]
    steps = re.findall(r"^\d+\. `(\S+\.py)`", section, re.MULTILINE)
    assert len(steps) > 5
    assert [name for name in visited if name in steps] == steps
    parts = ("io/formats/", "core/geometry/", "core/engines/", "core/checks/")
    assert {name for name in visited if name.startswith(parts)} - {*steps} == HELPERS


@pytest.mark.parametrize("pages", [PAGES, [ROOT / "CHANGELOG.md"]], ids=["pages", "changes"])
def test_every_link_leads_somewhere(pages):
    for page in pages:
        for target in LINK.findall(BLOCK.sub("", page.read_text("utf-8"))):
            path, _, anchor = target.partition("#")
            if path.startswith("https:"):
                continue
            goal = (page.parent / path).resolve() if path else page
            assert goal.exists() or goal == BUILT, f"{page.name}: {target}"
            if anchor:
                headings = re.findall(r"^#+ (.+)$", goal.read_text("utf-8"), re.MULTILINE)
                assert anchor in [h.lower().replace(" ", "-") for h in headings], target


def test_every_page_is_in_the_navigation_and_the_version_in_the_changelog():
    # mkdocs' own tags, which plain yaml does not know, do not occur in this file.
    listed = set(re.findall(r"[:-] (\S+\.md)$", text_of("mkdocs.yml"), re.MULTILINE))
    assert listed == {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")}
    assert f"## [{salsanext_cli.__version__}]" in text_of("CHANGELOG.md")


@pytest.mark.parametrize("name", ["README.md", "docs/start/install.md", "docs/start/first-scan.md"])
def test_a_first_installation_begins_with_a_clone_and_a_virtual_environment(name):
    """Systems such as Debian and Ubuntu refuse to install packages outside of one."""
    lines = [line for body in blocks(ROOT / name, "sh") for line in body.splitlines()]
    (installs, *_) = (
        n for n, line in enumerate(lines) if re.search(r"make demo|install \.$", line)
    )
    assert any(line.startswith("git clone ") for line in lines[:installs])
    for body in blocks(ROOT / name, "sh"):
        if "python -m pip install" in body:
            made = body.index("python3 -m venv .venv\nsource .venv/bin/activate\n")
            assert made < body.index("python -m pip install")


def test_the_simulated_drive_of_the_tutorial_has_the_name_of_its_later_steps(tmp_path, monkeypatch):
    page = DOCS / "tutorials/own-sensor.md"
    simulate, copy = blocks(page, "sh")[0].splitlines()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(synth, "record", record)
    words = shlex.split(simulate.replace("--scans 10", "--scans 1"))
    called(*words[1:], "--jobs", "1")
    program, option, source, target = shlex.split(copy)
    assert (program, option) == ("cp", "-r")
    shutil.copytree(source, target)
    (later,) = (body for body in blocks(page, "python") if "predictions" in body)
    (sequence,) = {scan.sequence for scan in find_scans(Path("drive"))}
    assert f"sequences/{sequence}/predictions" in later


@pytest.mark.parametrize("page", guide.PAGES, ids=lambda page: page.name + "-" + page.parent.name)
def test_the_figures_shown_are_those_measured_with_the_shipped_weights(page):
    stored, text = guide.stored_figures(), page.read_text("utf-8")
    weights = hashlib.sha256(default_weights().read_bytes()).hexdigest()
    for name, _ in guide.FIGURE.findall(text):
        assert stored[name.split(".")[0]]["weights"] == weights, "run docs/refresh.py figures"
    assert guide.with_figures(text, stored) == text, "run docs/refresh.py figures"
    assert text.count("<!-- / -->") == len(guide.FIGURE.findall(text))
    # A comment at the beginning of a line would end the paragraph.
    assert not re.search(r"^<!-- \w+\.", text, re.MULTILINE)


def test_every_picture_is_shown_and_can_be_drawn_again():
    shown = {
        (page.parent / target).resolve()
        for page in PAGES
        for target in re.findall(r"!\[[^]]*\]\(([^)]+)\)", page.read_text("utf-8"))
        if not target.startswith("https:")
    }
    files = {path for path in (DOCS / "images").rglob("*") if path.is_file()}
    assert files <= shown
    assert {DOCS / "images" / name for name in refresh.PICTURES} == files
    drawn = refresh.recorded_pictures()
    old = [name for name in refresh.PICTURES if drawn.get(name) != refresh.digests_of_picture(name)]
    assert not old, f"run docs/refresh.py pictures {' '.join(old)}"


def test_a_picture_of_the_page_depends_on_each_of_its_files(tmp_path):
    assert {"weights", "page"} == refresh.digests_of_picture("report.webp").keys()
    assert {"weights"} == refresh.digests_of_picture("demo.gif").keys()
    (tmp_path / "templates").mkdir()
    (tmp_path / "templates/page.css").write_text("a")
    digests = [refresh.digest_of_page(tmp_path)]
    changes = (("templates/page.css", "b"), ("templates/page.js", ""), ("templates/table.js", ""))
    for name, text in changes:
        (tmp_path / name).write_text(text)
        digests.append(refresh.digest_of_page(tmp_path))
    (tmp_path / "html.py").write_text("import os\n\nTITLE = 1\n")
    digests.append(refresh.digest_of_page(tmp_path))
    (tmp_path / "html.py").write_text("from elsewhere import os  # moved\n\nTITLE = 1\n")
    assert refresh.digest_of_page(tmp_path) == digests[-1]
    (tmp_path / "html.py").write_text("import os\n\nTITLE = 2\n")
    digests.append(refresh.digest_of_page(tmp_path))
    (tmp_path / "__pycache__").mkdir()
    (tmp_path / "__pycache__/html.pyc").write_bytes(b"\xff")
    assert refresh.digest_of_page(tmp_path) == digests[-1]
    assert len(set(digests)) == len(digests)


def test_the_live_example_is_built_before_the_site_whose_links_are_checked():
    recipe = text_of("Makefile").partition("\ndocs:")[2].partition("\n\n")[0]
    steps = [recipe.index(step) for step in (" demo ", "docs/example/report.html", "mkdocs build")]
    assert steps == sorted(steps)
    assert "mkdocs build --strict" in recipe
    assert "/docs/example/" in text_of(".gitignore").splitlines()
    targets = LINK.findall(text_of("docs/index.md"))
    assert "images/report-scan.webp" in targets
    assert str(BUILT.relative_to(DOCS)) in targets


def test_the_commands_for_a_wheel_install_the_file_in_the_folder(tmp_path):
    """`python` only repeats its arguments; nothing is installed or activated."""
    section = text_of("docs/start/install.md").partition("## Install it from a wheel file")[2]
    commands = BLOCK.search(section)[2].replace("source ", ": ")
    stand_ins = 'python3() { :; }\npython() { printf "%s\\n" "${@: -1}"; }\n'
    (extras,) = re.findall(r"`(python -m pip install [^`]*\[[^`]*)`", section)
    (tmp_path / "salsanext-9.9.9-py3-none-any.whl").touch()
    installed = guide.run(f"{stand_ins}{commands}{extras}\n", tmp_path).splitlines()
    file = "./salsanext-9.9.9-py3-none-any.whl"
    assert installed[-2:] == [file, f"{file}[fuse,ros]"]


def test_every_make_target_mentioned_exists():
    targets = set(re.findall(r"^([a-z-]+):", text_of("Makefile"), re.MULTILINE))
    for page in PAGES:
        text = page.read_text("utf-8")
        mentioned = re.findall(r"`make ([a-z-]+)`", text)
        mentioned += re.findall(r"^make ([a-z-]+)$", "\n".join(blocks(page, "sh")), re.MULTILINE)
        assert set(mentioned) <= targets, page.name


@pytest.fixture(scope="session")
def simulated(tmp_path_factory) -> Path:
    """Return the folder with simulated scans that the pages begin with."""
    folder = tmp_path_factory.mktemp("simulated")
    prepared.prepared_folder(folder, None)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.long if name == "tutorials/few-labels.md" else ())
        for name in RUN
    ],
)
def test_the_commands_of_the_page_work_as_typed(name, simulated, tmp_path):
    shutil.copytree(simulated, tmp_path, dirs_exist_ok=True)
    guide.outputs((DOCS / name).read_text("utf-8"), tmp_path)
