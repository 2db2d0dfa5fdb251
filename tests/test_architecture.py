"""Rules of the code base: imports, printing, compilation, length of files and functions, module
map."""

import ast
import inspect
import re
from collections.abc import Mapping
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from importlinter.cli import lint_imports

from companion.estimators import ESTIMATORS
from tests.paths import ROOT

FILES = sorted(path for folder in ("companion", "sim") for path in (ROOT / folder).rglob("*.py"))
COMPILES = "from companion.jit import step"
LONGEST_FILE = 400
LONGEST_FUNCTION = 50


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def imports_of(tree: ast.AST) -> dict[str, str]:
    """local name -> where it comes from, of every import in the file."""
    found: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.asname or alias.name.split(".")[0]: alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {
                alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names
            }
    return found


def test_import_contracts() -> None:
    """Those of pyproject.toml: sim -> companion, estimators without MAVLink, a codec without
    I/O."""
    assert lint_imports(config_filename=str(ROOT / "pyproject.toml"), no_cache=True) == 0


def packages_of(path: Path) -> set[str]:
    """The top-level packages that a file imports, anywhere in it."""
    return {source.split(".")[0] for source in imports_of(tree_of(path)).values()}


@pytest.mark.parametrize(
    ("package", "user"),
    [
        ("numba", "companion/jit.py"),
        ("llvmlite", "companion/jit.py"),
        ("jsbsim", "sim/airframes.py"),
    ],
)
def test_a_heavy_package_has_one_user(package: str, user: str) -> None:
    assert {name_of(path) for path in FILES if package in packages_of(path)} == {user}


def test_only_the_command_line_prints() -> None:
    for path in FILES:
        functions = {node.func for node in ast.walk(tree_of(path)) if isinstance(node, ast.Call)}
        called = {function.id for function in functions if isinstance(function, ast.Name)}
        assert "print" not in called or path.name.endswith("cli.py"), name_of(path)


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_every_file_has_a_docstring_and_is_short(path: Path) -> None:
    assert ast.get_docstring(tree_of(path)), "no docstring"
    lines = len(path.read_text(encoding="utf-8").splitlines())
    assert lines <= LONGEST_FILE, f"{lines} lines: split the file by role"


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_every_function_is_short(path: Path) -> None:
    for node in ast.walk(tree_of(path)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            assert lines <= LONGEST_FUNCTION, f"{node.name} has {lines} lines"


def test_the_module_map_is_the_tree() -> None:
    """Every package and module of the tree has one line in ARCHITECTURE.md, and vice versa."""
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8").split("## Module map")[1]
    listed = re.findall(r"^\| `((?:companion|sim)/[^`]*)` \|", text, re.MULTILINE)
    tree = {
        f"{name_of(path.parent)}/" if path.name == "__init__.py" else name_of(path)
        for path in FILES
    }

    assert len(listed) == len(set(listed)), "a line of the map is repeated"
    assert set(listed) == tree


def test_what_architecture_names_exists() -> None:
    """Every file that its text names, and what "Where to find" says is in a file."""
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8").split("## Module map")[0]
    names = {f"/{name_of(path)}" for path in FILES} | {f"/{path}" for path in _tests()}
    for path in set(re.findall(r"`([\w/]+\.py)`", text)):
        assert "NAME" in path or any(name.endswith(f"/{path}") for name in names), path
    table = text.split("## Where to find")[1].split("## The data path")[0]
    for listed, path in re.findall(r"((?:`\w+`(?:, | and )?)+) in `([\w/]+\.py)`", table):
        source = (ROOT / path).read_text(encoding="utf-8")
        for name in re.findall(r"\w+(?=`)", listed):
            assert re.search(rf"\b{name}\b", source), f"no {name} in {path}"


def _tests() -> list[str]:
    return [name_of(path) for path in (ROOT / "tests").rglob("*.py")]


def test_compiled_code_has_explicit_loops() -> None:
    """NumPy's linear algebra and reductions need scipy when compiled and differ from it when
    not."""
    for path in FILES:
        for step in _steps(tree_of(path)):
            where = f"{name_of(path)}: {step.name}"
            for node in ast.walk(step):
                assert not isinstance(node, ast.MatMult), where
                if isinstance(node, ast.Attribute):
                    assert node.attr not in {
                        "linalg",
                        "dot",
                        "sum",
                        "matmul",
                        "einsum",
                        "mean",
                        "var",
                        "std",
                    }, where


def test_compiled_code_depends_only_on_what_its_cache_is_named_after() -> None:
    """The cache is named after the files that compile and ``samples.py``: what a step uses must
    come from these."""
    compiled = {path for path in FILES if COMPILES in path.read_text(encoding="utf-8")}
    hashed = {name_of(path)[:-3].replace("/", ".") for path in compiled} | {
        "companion.samples",
        "companion.jit",
    }
    for path in compiled:
        if name_of(path).startswith("sim/"):
            # Numba itself watches the file; what it uses of the companion is in the name.
            continue
        tree = tree_of(path)
        imported, constants = imports_of(tree), _constants(tree)
        for step in _steps(tree):
            names = {node.id for node in ast.walk(step) if isinstance(node, ast.Name)}
            for name in _with_constants(names, constants):
                source = imported.get(name, "")
                if source.startswith("companion."):
                    module = source.rsplit(".", 1)[0]
                    assert module in hashed or source in hashed, (
                        f"{path.name}: {step.name} uses {source}"
                    )


def test_whoever_compiles_says_so_in_the_line_that_the_cache_looks_for() -> None:
    for path in FILES:
        if "companion.jit.step" in imports_of(tree_of(path)).values():
            assert COMPILES in path.read_text(encoding="utf-8"), name_of(path)


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_run_handles_exactly_the_kinds_of_its_method(name: str) -> None:
    """The compiled loop compares `kind` with the constants of `judging`: one for each step."""
    method = ESTIMATORS[name]
    source = inspect.getsource(getattr(method.run, "py_func", method.run))
    compared = {
        node.comparators[0].id
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Compare)
        and isinstance(node.left, ast.Name)
        and node.left.id == "kind"
        and isinstance(node.comparators[0], ast.Name)
    }
    assert compared == {kind.name for kind in method.steps}


def _steps(tree: ast.Module) -> list[ast.FunctionDef]:
    return [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and any(
            isinstance(decorator, ast.Name) and decorator.id == "step"
            for decorator in node.decorator_list
        )
    ]


def _constants(tree: ast.Module) -> dict[str, set[str]]:
    """Module constants -> the names in their definitions."""
    found: dict[str, set[str]] = {}
    for node in tree.body:
        if not isinstance(node, (ast.Assign, ast.AnnAssign)):
            continue
        targets, value = node.targets if isinstance(node, ast.Assign) else [node.target], node.value
        names = (
            {inner.id for inner in ast.walk(value) if isinstance(inner, ast.Name)}
            if value
            else set()
        )
        for target in targets:
            found |= {inner.id: names for inner in ast.walk(target) if isinstance(inner, ast.Name)}
    return found


def _with_constants(names: set[str], constants: dict[str, set[str]]) -> set[str]:
    """`names`, and those that the constants among them are made of."""
    known, waiting = set(names), list(names)
    while waiting:
        for inner in constants.get(waiting.pop(), set()) - known:
            known.add(inner)
            waiting.append(inner)
    return known


def test_no_import_circle() -> None:
    """Of the imports at the top of modules; those inside functions may go anywhere."""
    modules = {
        name_of(path).removesuffix(".py").removesuffix("/__init__").replace("/", "."): path
        for path in FILES
    }
    needs = {name: _needed(tree_of(path), modules) for name, path in modules.items()}
    TopologicalSorter(needs).prepare()  # raises CycleError with the circle


def _needed(tree: ast.Module, modules: Mapping[str, Path]) -> set[str]:
    found: set[str] = set()
    for node in tree.body:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= inner if inner & modules.keys() else {str(node.module)}
    return found & modules.keys()
