# SPDX-License-Identifier: MIT
"""The shape of the package: imports point one way, files stay small, the library is silent."""

import ast
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import salsanext_cli
from salsanext_cli.cli.app import COMMANDS

ROOT = Path(__file__).parents[1]
PACKAGE = Path(salsanext_cli.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))
LEVELS = (
    ("version", "errors", "interruption"),
    ("options",),
    ("files",),
    ("classes", "sensors", "compiled"),
    ("records",),
    ("formats", "geometry"),
    ("network",),
    ("engines", "results"),
    ("fitting",),
    ("uncertainty", "measures", "fusion"),
    ("labelling",),
    ("training", "synthesis", "parallel", "report"),
    ("stages",),
    ("cli",),
    ("__main__",),
)
"""A part may import those in the lines above it, never one beside it."""
LEVEL_OF = {part: level for level, parts in enumerate(LEVELS) for part in parts}
LONGEST = 400
"""Lines of a module, if it is one idea; most are shorter than 200."""


@cache
def tree_of(module: Path) -> ast.Module:
    return ast.parse(module.read_text("utf-8"))


def where(rule: Callable[[Path], object]) -> dict[str, object]:
    """Return by module what a rule finds wrong with it."""
    found = {str(module.relative_to(PACKAGE)): rule(module) for module in MODULES}
    return {name: wrong for name, wrong in found.items() if wrong}


def part_of(module: Path) -> str:
    return module.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(tree: ast.AST) -> Iterator[str]:
    """Yield every module that is imported anywhere, inside functions too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: relative import"
            assert node.module
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def own_parts(tree: ast.AST) -> set[str]:
    """Return the parts of the package that are imported."""
    names = (name.split(".") for name in imported(tree))
    parts = {name[1] for name in names if name[0] == "salsanext_cli" and len(name) > 1}
    return parts - {"__version__"}


def test_every_part_has_its_level():
    parts = {part_of(module) for module in MODULES} - {"__init__"}
    assert parts == set(LEVEL_OF)


def test_imports_point_one_way():
    def beside_or_below(module):
        part = part_of(module)
        others = own_parts(tree_of(module)) - {part} if part != "__init__" else set()
        return {other for other in others if LEVEL_OF[other] >= LEVEL_OF[part]}

    assert where(beside_or_below) == {}


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


def test_training_and_synthesis_can_be_removed():
    """Nothing but their own stages and commands, and the demonstration, may need them."""
    allowed = {"train", "tune", "synth", "demo"}
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


ROOMS_OF_MANY = {"cli", "stages"}
"""One file per command."""
MOST_FILES = 20
VAGUE = {"utils", "util", "helpers", "helper", "misc", "common", "tools"}


def test_rooms_are_small():
    rooms = Counter(module.parent.name for module in MODULES if module.parent != PACKAGE)
    assert {room: n for room, n in rooms.items() if n > MOST_FILES}.keys() <= ROOMS_OF_MANY
    assert not [module for module in MODULES if module.stem in VAGUE]


def test_stages_are_commands():
    """One file each, but `view`, which serves the page of `report`."""
    commands = {name.replace("-", "_") for names in COMMANDS.values() for name in names}
    stages = {path.stem for path in (PACKAGE / "stages").glob("*.py")} - {"__init__"}
    assert stages ^ commands == {"evaluate", "eval", "view"}


def test_files_are_short():
    lengths = {module: len(module.read_text("utf-8").splitlines()) for module in MODULES}
    assert {module: n for module, n in lengths.items() if n > LONGEST} == {}


def called(tree: ast.AST) -> Iterator[str]:
    """Yield what is called, dots and all, such as ``sys.exit``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func)


FORBIDDEN = {
    *("print", "input", "exit", "quit", "sys.exit", "os._exit", "eval", "exec"),
    *("pickle.load", "pickle.loads", "np.random.seed", "random.seed"),
}


def test_nothing_prints_exits_evaluates_or_unpickles():
    """Of two processes only the one that is to end does so at once."""
    found = where(lambda module: FORBIDDEN & set(called(tree_of(module))))
    assert found == {"interruption.py": {"os._exit"}, "parallel/worker.py": {"os._exit"}}


def test_torch_loads_weights_only():
    def without_the_keyword(module):
        calls = [n for n in ast.walk(tree_of(module)) if isinstance(n, ast.Call)]
        loads = [call for call in calls if ast.unparse(call.func) == "torch.load"]
        return [call.lineno for call in loads if "weights_only=True" not in ast.unparse(call)]

    assert where(without_the_keyword) == {}


def test_the_global_generator_is_left_as_it_was():
    """Torch initialises by its global generator only, so it is seeded in a fork."""

    def outside_of_forks(module):
        tree = tree_of(module)
        blocks = [node for node in ast.walk(tree) if isinstance(node, ast.With)]
        forks = [b for b in blocks if any("fork_rng" in ast.unparse(i) for i in b.items)]
        inside = [name for fork in forks for name in called(fork)]
        return list(called(tree)).count("torch.manual_seed") - inside.count("torch.manual_seed")

    assert where(outside_of_forks) == {}


def test_no_exception_is_swallowed_whole():
    def swallowed(module):
        handlers = [n for n in ast.walk(tree_of(module)) if isinstance(n, ast.ExceptHandler)]
        return [
            handler.lineno
            for handler in handlers
            if (handler.type is None or ast.unparse(handler.type) in ("Exception", "BaseException"))
            and not any(isinstance(n, ast.Raise) and n.exc is None for n in ast.walk(handler))
        ]

    assert where(swallowed) == {}


def test_docstrings_open_with_a_verb_or_a_noun():
    """They do not open with a question word: "Ids by name", not "Which name has which id"."""
    questions = {"What", "Which", "How", "Where", "When", "Who", "Whose", "Whether", "Why"}

    def asking(module):
        texts = (
            node.value.value
            for node in ast.walk(tree_of(module))
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        )
        return [text for text in texts if isinstance(text, str) and text.split()[0] in questions]

    assert where(asking) == {}


def test_only_files_and_formats_open_point_files():
    """Any other reader of points would read them differently one day."""
    readers = {"np.fromfile", "np.load", "np.save", "np.savez", "np.savetxt", "np.loadtxt"}

    def readings(module):
        if part_of(module) in ("files", "formats"):
            return set()
        tree = tree_of(module)
        return readers & set(called(tree)) | {"plyfile", "laspy"} & set(imported(tree))

    assert where(readings) == {}


def test_plyfile_is_imported_in_one_place_and_click_nowhere():
    """Plyfile is GPL, and the package MIT; Typer carries its own Click."""
    found = where(lambda m: {"plyfile", "click"} & {n.split(".")[0] for n in imported(tree_of(m))})
    assert found == {"formats/ply.py": {"plyfile"}}


def test_commands_are_short():
    """A command is parse, call, report."""
    functions = [
        node
        for module in (PACKAGE / "cli").glob("*.py")
        for node in tree_of(module).body
        if isinstance(node, ast.FunctionDef)
    ]
    assert "predict" in {node.name for node in functions}
    assert [n.name for n in functions if n.body[-1].end_lineno - n.body[0].lineno > 40] == []
