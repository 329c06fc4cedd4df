# SPDX-License-Identifier: MIT
"""Few modules can lose a file of the user: those that remove, replace or write files themselves."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from package_trees import MODULES, name_of, nodes_of, tree_of

ROOT = Path(__file__).parents[1]
REMOVERS = {
    "io/files/atomic.py": "gives complete files their names; unfinished files of killed runs",
    "io/files/locks.py": "lock files, temporary folders of killed runs, empty folders",
    "io/files/user_cache.py": "the files of the cache that were not used for the longest time",
    "runs/loop/cluster/node_requirements.py": "the probe of a folder that it wrote",
    "runs/loop/finished_attempts.py": "a temporary folder of the run",
    "runs/results/owned_folder.py": "files of an output folder that salsanext wrote",
}
"""Modules that may remove or replace files, and which; see `docs/project/development.md`."""
LIBRARY_WRITERS = {
    "core/engines/graphs.py": "a model for OpenVINO, into a new temporary folder",
    "io/formats/ros/bag_copies.py": "a copy of a bag, under the name that its caller gives",
    "runs/loop/cluster/node_requirements.py": "the probe of a folder, under a name of its own",
}
"""Modules that may let a library write a file, and which."""
REPLACING = {
    "append_line",
    "appending",
    "save_weights",
    "save_with_card",
    "write_bytes",
    "write_json",
    "writing",
}
"""Functions of the package that replace a file unless their caller forbids it."""
WRITERS = {
    "runs/copies/bag_sources.py": "the record of the bags that were copied into a folder",
    "commands/stages/import_weights.py": "the target, by `overwrite`",
    "commands/stages/submit.py": "the target, by `overwrite`",
    "commands/stages/tune.py": "the target, by `overwrite`",
    "io/files/json_files.py": "records of the callers of `write_json`",
    "io/files/user_cache.py": "the cache",
    "io/formats/kitti_labels.py": "`sn.write_labels`, for callers from Python",
    "io/formats/ply.py": "`sn.write_ply`, for callers from Python",
    "runs/annotation/label_records.py": "a line at the end of the list of imported labels",
    "runs/loop/event_file.py": "lines at the end of a file of events",
    "runs/annotation/picked_data_set.py": "the record of `pick`",
    "runs/records/digest_files.py": "files that are named after their content",
    "runs/results/manifest.py": "records of stages",
    "runs/results/owned_folder.py": "files of an output folder that are not foreign",
}
"""Modules that may import the functions above, and what they write."""
REMOVAL_NAMES = {"removedirs", "rename", "renames", "rmdir", "rmtree", "unlink"}
"""Functions and methods that remove or rename, whatever module or object has them."""
NAMES_OF_OS = {"remove", "replace"}
REPLACING_OF_OS = {f"os.{name}" for name in NAMES_OF_OS}
WRITING_FUNCTIONS = {
    *("numpy.memmap", "numpy.save", "numpy.savetxt", "numpy.savez", "numpy.savez_compressed"),
    *("numpy.lib.format.open_memmap", "torch.save", "os.link", "os.symlink", "os.truncate"),
    *("shutil.copy", "shutil.copy2", "shutil.copyfile", "shutil.copytree", "shutil.move"),
    *("shutil.make_archive", "shutil.unpack_archive", "tarfile.open", "gzip.open"),
    *("zipfile.ZipFile", "logging.FileHandler", "sqlite3.connect"),
}
"""Functions of libraries that write or replace the file that they are given."""
NAMES_OF_WRITING = {function.rpartition(".")[2] for function in WRITING_FUNCTIONS}
WRITING_METHODS = {
    *("write_bytes", "write_text", "hardlink_to", "symlink_to", "tofile", "extractall"),
    *("imsave", "savefig", "save_file", "save_model", "write_image", "write_point_cloud"),
    *("Writer", "write_feather", "write_table"),
}
"""The same for methods, and for functions that several libraries have.

Functions of the package with these names have arguments of their own.
"""
WRITING_MODE = re.compile(r"[wxa+rbt]*[wxa+][wxa+rbt]*")


def imported_names(tree: ast.AST) -> dict[str, str]:
    """Return the full name of everything that a module imports, by the name that it uses."""
    full: dict[str, str] = {}
    for node in nodes_of(tree):
        if isinstance(node, ast.Import):
            full |= {alias.asname: alias.name for alias in node.names if alias.asname}
        elif isinstance(node, ast.ImportFrom):
            full |= {
                alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names
            }
    return full


def full_name(node: ast.expr, names: dict[str, str]) -> str:
    """Return the full name of a function, such as numpy.save for np.save."""
    first, dot, rest = ast.unparse(node).partition(".")
    return f"{names.get(first, first)}{dot}{rest}"


def is_bytes_io(node: ast.expr) -> bool:
    return isinstance(node, ast.Call) and last_name(node.func) == "BytesIO"


def last_name(node: ast.expr) -> str:
    """Return the name of a function without the object or module that has it."""
    return getattr(node, "attr", getattr(node, "id", ""))


def open_files(tree: ast.AST) -> set[str]:
    """Return the names of files that are open, or in memory: writing into them replaces none."""
    names: set[str] = set()
    for node in nodes_of(tree):
        if isinstance(node, ast.withitem) and isinstance(node.optional_vars, ast.Name):
            names.add(node.optional_vars.id)
        elif isinstance(node, ast.Lambda):
            names |= {argument.arg for argument in node.args.args}
        elif isinstance(node, ast.Assign) and is_bytes_io(node.value):
            names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    return names


def is_string(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def opens_for_writing(call: ast.Call) -> bool:
    """Return whether a call opens a file by `open`, `PATH.open` or `os.open` for writing."""
    if last_name(call.func) != "open":
        return False
    if ast.unparse(call.func) == "os.open":
        return [ast.unparse(flags) for flags in call.args[1:2]] != ["os.O_RDONLY"]
    arguments = [*call.args, *(keyword.value for keyword in call.keywords)]
    modes = [argument.value for argument in arguments if is_string(argument)]
    return any(WRITING_MODE.fullmatch(mode) for mode in modes)


def replaces_path(call: ast.Call) -> bool:
    """Return whether a call is `PATH.replace(PATH)`.

    Texts are replaced with two arguments, records with keywords, and a mapping is no path.
    """
    function = call.func
    if not isinstance(function, ast.Attribute) or function.attr != "replace":
        return False
    is_of_owned_folder = ast.unparse(function.value).startswith("OwnedFolder(")
    return len(call.args) == 1 and not call.keywords and not is_of_owned_folder


def is_removal(function: ast.Attribute, names: dict[str, str]) -> bool:
    """Return whether a function or method removes, renames or replaces a file."""
    if function.attr in REMOVAL_NAMES:
        return True
    return function.attr in NAMES_OF_OS and full_name(function, names) in REPLACING_OF_OS


def removals(tree: ast.AST) -> Iterator[str]:
    """Yield what removes, renames, replaces or opens a file for writing, as code."""
    names = imported_names(tree)
    for local, full in names.items():
        if full in REPLACING_OF_OS or full.rpartition(".")[2] in REMOVAL_NAMES:
            yield local
    for node in nodes_of(tree):
        if isinstance(node, ast.Attribute) and is_removal(node, names):
            yield ast.unparse(node)
        if isinstance(node, ast.Call) and (replaces_path(node) or opens_for_writing(node)):
            yield ast.unparse(node)


def writes(function: ast.expr, names: dict[str, str]) -> bool:
    """Return whether a function writes the file that it is given."""
    if isinstance(function, ast.Attribute) and function.attr in WRITING_METHODS:
        return True
    local = last_name(function)
    is_possible = local in names or local in NAMES_OF_WRITING
    return is_possible and full_name(function, names) in WRITING_FUNCTIONS


def library_writes(tree: ast.AST) -> Iterator[str]:
    """Yield the calls by which a path or a library writes a file, as code."""
    names = imported_names(tree)
    files = open_files(tree)
    for node in nodes_of(tree):
        if not isinstance(node, ast.Call) or not writes(node.func, names):
            continue
        # The formatter of the help has a method `write_text` as well.
        is_help = ast.unparse(node.func).startswith("formatter.")
        has_open_file = any(isinstance(a, ast.Name) and a.id in files for a in node.args)
        if node.args and not is_help and not has_open_file:
            yield ast.unparse(node)


@pytest.mark.parametrize(
    "code",
    [
        "path.unlink(missing_ok=True)",
        "stack.callback(shutil.rmtree, folder)",
        "from shutil import rmtree",
        "from os import replace as put",
        "os.replace(new, old)",
        "new.replace(old)",
        "open(path, 'w')",
        "path.open(mode='ab')",
        "os.open(path, os.O_WRONLY | os.O_CREAT)",
        "path.with_suffix('.tmp').replace(path)",
        "Path(a).replace(b)",
    ],
)
def test_what_removes_or_replaces_files_is_seen(code):
    assert list(removals(ast.parse(code)))


@pytest.mark.parametrize(
    "code",
    [
        "OwnedFolder(out, stage).replace(files)",
        "path.open('rb')",
        "path.open(b'rb')",
        "os.open(folder, os.O_RDONLY)",
        "text.replace('a', 'b')",
        "replace(record, field=1)",
        "from dataclasses import replace",
    ],
)
def test_what_replaces_no_file_is_allowed(code):
    assert list(removals(ast.parse(code))) == []


@pytest.mark.parametrize(
    "code",
    [
        "path.write_text(text)",
        "import numpy as np; np.save(path, array)",
        "from numpy import savez as save; save(folder / 'a', array)",
        "with new_folder() as folder: torch.save(weights, folder / 'a')",
        "shutil.move(new, old)",
        "from zipfile import ZipFile; ZipFile(path, 'w')",
        "array.tofile(path)",
        "figure.savefig(path, dpi=100)",
        "openvino.save_model(model, path, compress_to_fp16=False)",
        "safetensors.torch.save_file(tensors, path)",
        "link.symlink_to(path)",
        "rosbag1.Writer(path)",
    ],
)
def test_what_writes_files_is_seen(code):
    assert list(library_writes(ast.parse(code)))


@pytest.mark.parametrize(
    "code",
    [
        "write_bytes(path, content)",
        "save(lambda file: numpy.save(file, array))",
        "png = BytesIO(); figure.savefig(png)",
        "with writing(path) as file: zipfile.ZipFile(file, 'w')",
        "safetensors.torch.save(tensors)",
    ],
)
def test_what_writes_into_open_files_and_memory_is_allowed(code):
    assert list(library_writes(ast.parse(code))) == []


def test_few_modules_remove_or_replace_files():
    """A file of the user can only be lost in these; all others call them."""
    removers = {name_of(module) for module in MODULES if any(removals(tree_of(module)))}
    assert removers == REMOVERS.keys()
    page = (ROOT / "docs/project/development.md").read_text("utf-8")
    assert {remover for remover in REMOVERS if f"`{remover}`" not in page} == set()


def test_libraries_write_no_files_of_the_user():
    writers = {name_of(module) for module in MODULES if any(library_writes(tree_of(module)))}
    assert writers == LIBRARY_WRITERS.keys()


def imported_from_io(tree: ast.AST) -> set[str]:
    """Return the names that a module imports from the wing of files."""
    return {
        alias.name
        for node in nodes_of(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("salsanext_cli.io.")
        for alias in node.names
    }


def test_few_modules_import_the_functions_that_replace_files():
    """Files that the user names are written by `write_target`, which must state `overwrite`."""
    writers = {
        name_of(module) for module in MODULES if imported_from_io(tree_of(module)) & REPLACING
    }
    assert writers == WRITERS.keys()
