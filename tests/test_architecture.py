# SPDX-License-Identifier: MIT
"""The shape of the package: imports point one way, files stay small."""

import ast
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from graphlib import TopologicalSorter
from pathlib import Path

from package_trees import MODULES, PACKAGE, name_of, nodes_of, tree_of

from salsanext_cli.commands.line.app import COMMANDS
from salsanext_cli.core.texts import percentage

ROOT = Path(__file__).parents[1]
WINGS = ("core", "io", "runs", "commands")
"""Parts that consist of parts: arrays, files, output folders, and the command line."""
LEVELS = (
    (
        "version",
        "core.caches",
        "core.memo",
        "core.notices",
        "core.records",
        "core.texts",
        "core.wording",
    ),
    ("core.errors", "core.interruptions", "core.poses"),
    (
        "core.compiled",
        "core.field_rules",
        "core.optional_packages",
        "core.plain_data",
        "core.plug_ins",
        "core.classes",
    ),
    ("core.sensors",),
    ("core.geometry", "core.network"),
    ("core.checks", "core.engines", "core.fusion"),
    ("core.fitting", "core.labelling", "core.uncertainty"),
    ("core.on_device",),
    ("core.labellers",),
    ("core.estimators",),
    ("core.api", "core.measures"),
    ("io.bag_index", "io.files"),
    (
        "io.formats",
        "io.kernel_cache",
        "io.label_spaces",
        "io.frames",
        "io.poses",
        "io.sensors",
        "io.stated_fields",
        "io.weights",
    ),
    ("io.annotation_tools", "io.user_caches"),
    ("runs.network_announcement", "runs.records", "runs.scans", "runs.sensor_request"),
    ("runs.network_settings", "runs.results"),
    ("runs.fit",),
    ("runs.drives",),
    ("runs.summary",),
    ("runs.annotation", "runs.loop"),
    ("runs.copies",),
    ("training", "synthesis", "report"),
    ("commands.score_limits", "drive_labels"),
    ("commands.evaluation", "commands.jobs"),
    ("commands.stages",),
    ("commands.picked_labels",),
    ("commands.line", "api"),
    ("__main__",),
)
"""A part may import those in the lines above it, never one beside it."""
LEVEL_OF = {part: level for level, parts in enumerate(LEVELS) for part in parts}
LONGEST = 400
"""Lines of a module, if it is one idea; most are shorter than 200."""


def part_of(module: Path) -> str:
    parts = module.relative_to(PACKAGE).with_suffix("").parts
    return part_of_names(parts)


def part_of_names(names: Sequence[str]) -> str:
    """Return the part of a module, whose dotted name is split; a wing for the wing itself."""
    depth = 2 if names[0] in WINGS and names[1:2] != ("__init__",) else 1
    return ".".join(names[:depth])


def imported(tree: ast.AST) -> Iterator[str]:
    """Yield every module that is imported anywhere, inside functions too."""
    for node in nodes_of(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.module, "relative import"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def own_parts(tree: ast.AST) -> set[str]:
    """Return the parts of the package that are imported."""
    names = (tuple(name.split(".")) for name in imported(tree))
    own = {name[1:] for name in names if name[0] == "salsanext_cli" and len(name) > 1}
    # A wing alone only says where the other name of the import is.
    return {part_of_names(name) for name in own} - {"__version__", *WINGS}


def test_every_part_has_its_level_and_imports_point_one_way():
    assert {part_of(module) for module in MODULES} - {"__init__", *WINGS} == set(LEVEL_OF)
    for module in MODULES:
        part = part_of(module)
        if part == "__init__" or part in WINGS:
            continue
        others = own_parts(tree_of(module)) - {part}
        assert {other for other in others if LEVEL_OF[other] >= LEVEL_OF[part]} == set(), module


def module_name(module: Path) -> str:
    parts = module.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


def test_no_modules_import_each_other_in_a_circle():
    """Imports inside functions and for type checkers count too; `__init__` only names homes."""
    names = {module_name(module): module for module in MODULES} | {"salsanext_cli": PACKAGE}
    imports = {
        name: {found for found in imported(tree_of(module)) if found in names}
        - {"salsanext_cli", name}
        for name, module in names.items()
        if name != "salsanext_cli"
    }
    TopologicalSorter(imports).prepare()  # Raises an error that names a circle.


def types(tree: ast.AST) -> Iterator[str]:
    """Yield the types of all arguments, fields and results, and the calls that check a type."""
    for node in nodes_of(tree):
        if isinstance(node, ast.arg | ast.AnnAssign) and node.annotation:
            yield ast.unparse(node.annotation)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.returns:
            yield ast.unparse(node.returns)
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "isinstance":
            yield ast.unparse(node.args[1])


FOLDERS_OF_CACHES = "core/caches.py"
"""The caches that are handed in lend a temporary folder to libraries that write files."""


def test_the_core_takes_no_path():
    """Arrays in, arrays out: files are read above it."""
    core = [module for module in MODULES if module.is_relative_to(PACKAGE / "core")]
    assert len(core) > 60
    takers = {
        name_of(module)
        for module in core
        if any(re.search(r"\bPath\b", kind) for kind in types(tree_of(module)))
    }
    assert takers == {FOLDERS_OF_CACHES}


OPTION_KEYS = "core/network/tuned_settings.py"
"""Names of options that are keys of a file format."""


def texts(tree: ast.Module) -> Iterator[str]:
    """Yield the texts in the code of a module, without the docstrings."""
    described = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docstrings = {
        node.body[0].value
        for node in nodes_of(tree)
        if isinstance(node, described) and node.body and isinstance(node.body[0], ast.Expr)
    }
    for node in nodes_of(tree):
        is_text = isinstance(node, ast.Constant) and isinstance(node.value, str)
        if is_text and node not in docstrings:
            yield node.value


def test_only_the_command_line_names_options():
    """Below it, messages name arguments, which the command line spells as its options."""
    # A style such as `style="--share:` is a property of CSS; two hyphens at the end of a text
    # begin an option whose name is computed. Commands of Ray and PDAL have options of their own.
    option = re.compile(
        r"(?<!style=\")(?<!ray start )(?<!ray start --head )--(?!writers\.las)([a-zA-Z]|$)"
    )
    below = [m for m in MODULES if part_of(m) not in ("commands.line", "__main__")]
    assert len(below) > 300
    namers = {
        name_of(module)
        for module in below
        if any(option.search(text) for text in texts(tree_of(module)))
    }
    assert namers == {OPTION_KEYS}


def test_training_and_synthesis_can_be_removed():
    """Nothing but their own stages and commands, and the demonstration, may need them."""
    of_train = {"train", "new_training", "training_scenes", "training_plan", "recipe_changes"}
    of_train |= {"epoch_files", "event_files"}
    of_tune = {"tune", "tune_tables", "risk_picture"}
    allowed = of_train | of_tune | {"synth", "demo"}
    users = {
        module.stem
        for module in MODULES
        if part_of(module) not in ("training", "synthesis")
        and own_parts(tree_of(module)) & {"training", "synthesis"}
    }
    assert users <= allowed


def test_every_python_file_begins_with_its_licence():
    others = ("tests", "examples", "benchmarks", "docs", "tools")
    folders = [PACKAGE, *(ROOT / name for name in others)]
    files = [path for folder in folders for path in folder.rglob("*.py")]
    first = {path: path.read_text("utf-8").partition("\n")[0] for path in files}
    assert [path for path, line in first.items() if line != "# SPDX-License-Identifier: MIT"] == []


SUFFIXES = {".css", ".html", ".js", ".py", ".safetensors", ".toml", ".yaml"}
"""Of the files that the wheel packs; those of editors and merges are left behind by mistake."""


def test_the_package_has_files_of_its_own_only():
    packed = (path for path in PACKAGE.rglob("*") if "__pycache__" not in path.parts)
    others = {path.name for path in packed if path.is_file() and path.suffix not in SUFFIXES}
    assert others == {"py.typed"}


ROOMS_OF_MANY = {"commands", "stages"}
"""One file per command. Ruff counts the statements of functions."""
MAX_FILES = 20


def test_rooms_and_files_are_small():
    rooms = Counter(module.parent for module in MODULES if module.parent != PACKAGE)
    assert {room.name for room, count in rooms.items() if count > MAX_FILES} <= ROOMS_OF_MANY
    lengths = {module: len(module.read_text("utf-8").splitlines()) for module in MODULES}
    assert {module: n for module, n in lengths.items() if n > LONGEST} == {}


def test_percentages_of_messages_have_one_form():
    """Python's format "%" has no space before the sign; `percentage` has."""
    specs = [
        f"{name_of(module)}:{node.lineno}"
        for module in MODULES
        for node in nodes_of(tree_of(module))
        if isinstance(node, ast.FormattedValue) and node.format_spec
        if ast.unparse(node.format_spec).rstrip("'\"").endswith("%")
    ]
    assert specs == []
    assert [percentage(0.7266), percentage(0.7266, 0)] == ["72.7 %", "73 %"]
    shares = (0.001234, 0.05, 1.0)
    texts = ["0.12 %", "5 %", "100 %"]
    assert [percentage(share, figures=2) for share in shares] == texts


def test_stages_are_commands():
    """One file each, but `view`, which serves the page of `report`, and two more of `train`."""
    commands = {name.replace("-", "_") for names in COMMANDS.values() for name in names}
    stages = {path.stem for path in (PACKAGE / "commands/stages").glob("*.py")} - {"__init__"}
    assert stages ^ commands == {"evaluate", "eval", "view", "training_scenes", "new_training"}
