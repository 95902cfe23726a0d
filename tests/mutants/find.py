"""Find faults that no test notices: `make mutants`, explained in docs/develop.md.

cosmic-ray makes the mutants and runs the tests. Here stands what our tree needs beyond that: which mutants are worth a
run, which tests judge each, a copy of the tree to change, and the marks of the equivalent ones.

The copy takes over the kernels that the tests have compiled. A mutant of compiled code, or of what it imports, compiles
these kernels anew: 10 to 100 s more. `bus/socketcan.py` and `bus/recvmmsg.py` need a kernel with CAN: elsewhere many of
their mutants survive. A mark is the text of the line; a run without ``--sample`` names marks that no longer match.
``cr-report --show-output build/mutants/session.sqlite`` shows which test noticed each mutant.
"""

import argparse
import ast
import difflib
import fcntl
import glob
import os
import random
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import parso
from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.mutating import mutate_and_test, mutate_code
from cosmic_ray.operators.operator import Example, Operator
from cosmic_ray.plugins import OPERATOR_PROVIDERS, get_operator
from cosmic_ray.testing import run_tests
from cosmic_ray.util import read_python_source
from cosmic_ray.work_db import use_db
from cosmic_ray.work_item import MutationSpec, TestOutcome, WorkerOutcome, WorkItem, WorkResult

from canskin.errors import InputError, RunError, SkinError
from shell.compiled import FolderGiven
from shell.terminal import progress

ROOT: Final = Path(__file__).parents[2]
MARKS: Final = Path(__file__).with_name("equivalent.toml")
FOLDER: Final = ROOT / "build" / "mutants"
#: The tree that is changed. It stays where it is, so that no file is compiled twice.
COPY: Final = FOLDER / "tree"
#: Compiled kernels, for mutants that change none; kept from run to run.
KERNELS: Final = FOLDER / "kernels"
#: Results in cosmic-ray's own form: `cr-report`, `cr-html` read them.
SESSION: Final = FOLDER / "session.sqlite"
PATHS: Final = (
    "bandwidth",
    "bus",
    "calibration",
    "classifier/dag.py",
    "classifier/decide.py",
    "classifier/newest_sums.py",
    "classifier/novelty.py",
    "classifier/observer.py",
    "commissioning",
    "dbc",
    "gateway",
    "nodes",
    "reconstructor/temporal_filter.py",
    "views/page/guard.py",
    "health/state.py",
)
#: Small faults only: cosmic-ray replaces each binary operator and each comparison by every other one, and most of
#: those mutants end in the first line that any test runs.
BINARY: Final = (
    "Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "FloorDiv_Mul", "Mod_FloorDiv", "Pow_Mul", "RShift_LShift",
    "LShift_RShift", "BitOr_BitAnd", "BitAnd_BitOr", "BitXor_BitOr",
)  # fmt: skip
COMPARISONS: Final = ("Eq_NotEq", "NotEq_Eq", "Lt_LtE", "LtE_Lt", "Gt_GtE", "GtE_Gt", "Is_IsNot", "IsNot_Is")
OPERATORS: Final = (
    *(f"core/ReplaceBinaryOperator_{swap}" for swap in BINARY),
    *(f"core/ReplaceComparisonOperator_{swap}" for swap in COMPARISONS),
    "core/AddNot",
    "core/NumberReplacer",
    "core/ReplaceAndWithOr",
    "core/ReplaceBreakWithContinue",
    "core/ReplaceContinueWithBreak",
    "core/ReplaceFalseWithTrue",
    "core/ReplaceOrWithAnd",
    "core/ReplaceTrueWithFalse",
    "core/ReplaceUnaryOperator_Delete_Not",
    "core/ReplaceUnaryOperator_USub_UAdd",
    "core/ZeroIterationForLoop",
    "canskin/RemoveStatement",
)
#: A mutant hangs when its tests take PATIENCE times the time without a fault, and LEAST_PATIENCE_S: some compile.
PATIENCE: Final = 5.0
LEAST_PATIENCE_S: Final = 180.0
#: Memory of one process, so that an endless loop leaves memory to other processes.
MEMORY_BYTES: Final = 4 << 30


class RemoveStatement(Operator):
    """Leaves out a call, or an assignment to a field or an element: the fault that cosmic-ray does not know."""

    def mutation_positions(self, node: parso.tree.NodeOrLeaf) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
        """Yield the place of `node` when it is such a statement."""
        if node.parent is None or node.parent.type != "simple_stmt":
            return
        is_call = node.type in {"atom_expr", "power", "await"}
        if is_call or node.type in {"raise_stmt", "del_stmt"} or (node.type == "expr_stmt" and _changes_object(node)):
            yield node.start_pos, node.end_pos

    def mutate(self, node: parso.tree.NodeOrLeaf, _index: int) -> parso.tree.NodeOrLeaf:
        """Return `pass` in its place."""
        return parso.python.tree.Keyword("pass", node.start_pos, node.get_first_leaf().prefix)

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Show the operator at work."""
        return (Example("x.clear()", "pass"), Example("x.y = 1", "pass"))


def _changes_object(statement: parso.tree.BaseNode) -> bool:
    """Tell whether an assignment changes an object; without a local variable, the next line would fail anyway."""
    target, sign = statement.children[0], statement.children[1]
    is_part = any(mark in target.get_code(include_prefix=False) for mark in ".[")
    return is_part or (sign.type == "operator" and sign.value != "=")


class Change(NamedTuple):
    """What a mutant changes: the file from the root on, the line, and what stands there before and after."""

    path: str
    line: int
    before: str
    after: str

    @property
    def mark(self) -> tuple[str, str, str]:
        """How `equivalent.toml` names it: by its text, which stays when lines move."""
        return self.path, " ".join(self.before.split()), " ".join(self.after.split())


def main() -> int:
    """Run the command line; 0 when every mutant was judged, whatever survived."""
    options = _options()
    FOLDER.mkdir(parents=True, exist_ok=True)
    with (FOLDER / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print(f"another `make mutants` is at work in {FOLDER}: wait for its end", file=sys.stderr)
            return 2
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.default_int_handler)  # they end it as Ctrl-C does
        try:
            return _run(options)
        except SkinError as error:
            print(error, file=sys.stderr)
        except KeyboardInterrupt:
            print("stopped", file=sys.stderr)
    return 2


def _run(options: argparse.Namespace) -> int:
    # The soft limit alone: a program with sanitizers reserves more than there is, and its test lifts the limit.
    hard_bytes = resource.getrlimit(resource.RLIMIT_DATA)[1]
    soft_bytes = MEMORY_BYTES if hard_bytes == resource.RLIM_INFINITY else min(MEMORY_BYTES, hard_bytes)
    resource.setrlimit(resource.RLIMIT_DATA, (soft_bytes, hard_bytes))
    _copy_tree()
    _copy_kernels()
    os.chdir(COPY)
    os.environ["PYTHONPATH"] = os.pathsep.join(map(str, (COPY, COPY / "client", *COPY.glob("client/*"))))
    OPERATOR_PROVIDERS["canskin"] = {"RemoveStatement": RemoveStatement}
    return _judge(_choose(options))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="make mutants", description="find faults that no test notices, but for slow tests"
    )
    parser.add_argument("paths", nargs="*", default=PATHS, help="files or folders of code (default: %(default)s)")
    parser.add_argument("--sample", type=_count, metavar="N", help="draw N mutants at random (default: all)")
    parser.add_argument("--seed", type=int, default=0, help="of the draw (default: %(default)s)")
    parser.add_argument("--without", nargs="+", default=(), metavar="PATH", help="leave these files or folders out")
    options = parser.parse_args()
    options.paths, options.without = (
        [_ours(parser, path) for path in each] for each in (options.paths, options.without)
    )
    return options


def _count(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"expected a number of mutants from 1 on, got {text}")
    return number


def _ours(parser: argparse.ArgumentParser, path: str) -> str:
    """Return a path from the root of the project on; only such a path names a file of the copy."""
    full = (ROOT / path).resolve()
    if not full.exists() or not full.is_relative_to(ROOT):
        parser.error(f"expected a file or folder from the root of the project on, got {path!r}")
    return full.relative_to(ROOT).as_posix()


def _files() -> set[str]:
    """Return the names of our files, from the root on."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    ).stdout.split("\0")  # fmt: skip
    return {name for name in listed if name and (ROOT / name).is_file()}


def _copy_tree() -> None:
    """Bring `COPY` up to date; a file that did not change keeps its time."""
    ours = _files()
    for path in [path for path in COPY.rglob("*") if path.is_file() and "__pycache__" not in path.parts]:
        if path.relative_to(COPY).as_posix() not in ours:
            path.unlink()
    for name in ours:
        source, target = ROOT / name, COPY / name
        if not target.exists() or source.read_bytes() != target.read_bytes():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, target)


def _copy_kernels() -> None:
    """Give the copy what was compiled beside our files, where that is newer."""
    folders = {Path(name).parent for name in _files()}
    for index in (each for folder in folders for each in (ROOT / folder).glob("__pycache__/*.nbi")):
        file = COPY / index.relative_to(ROOT).parents[1] / "any.py"
        target = KERNELS / FolderGiven.get_suitable_cache_subpath(str(file)) / index.name
        if target.exists() and target.stat().st_mtime >= index.stat().st_mtime:
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        for source in (*index.parent.glob(f"{glob.escape(index.stem)}.*.nbc"), index):  # the index names the others
            shutil.copy2(source, target.parent)


def _mutants(paths: list[str]) -> list[WorkItem]:
    """List the mutants of `paths`, in an order that is the same in every run."""
    files = {file for path in paths for file in ([Path(path)] if path.endswith(".py") else Path(path).rglob("*.py"))}
    return [item for file in sorted(files) for item in _mutants_of(file)]


def _mutants_of(file: Path) -> Iterator[WorkItem]:
    nodes = list(ast_nodes(get_ast_from_path(file)))
    for name in OPERATORS:
        operator = get_operator(name)()
        places = (place for node in nodes for place in operator.mutation_positions(node))
        for occurrence, (start, end) in enumerate(places):
            mutation = MutationSpec(file, name, occurrence, start, end)
            yield WorkItem.single(f"{file} {name} {occurrence}", mutation)


def _choose(options: argparse.Namespace) -> list[tuple[WorkItem, Change]]:
    """Draw the mutants to judge."""
    items = [item for item in _mutants(options.paths) if not any(_is_below(item, path) for path in options.without)]
    if options.sample is not None:
        random.Random(options.seed).shuffle(items)
    marks = {(mark["file"], mark["before"], mark["after"]) for mark in tomllib.loads(MARKS.read_text())["equivalent"]}
    chosen: list[tuple[WorkItem, Change]] = []
    met = set()
    for item in items:
        if len(chosen) == options.sample:
            break
        change = _change(item)
        if change is not None and change.mark in marks:
            met.add(change.mark)
        elif change is not None:
            chosen.append((item, change))
    if options.sample is None:
        files = {item.mutations[0].module_path.as_posix() for item in items}
        for path, before, after in sorted(mark for mark in marks - met if mark[0] in files):
            print(f"{MARKS.name}: {path} has no mutant {before!r} to {after!r} any more", file=sys.stderr)
    print(f"{len(chosen)} mutants, {len(met)} more are marked as equivalent", flush=True)
    return chosen


def _is_below(item: WorkItem, path: str) -> bool:
    return item.mutations[0].module_path.is_relative_to(path)


def _change(item: WorkItem) -> Change | None:
    """Return what a mutant changes; None when no behaviour can change."""
    mutation = item.mutations[0]
    source = _source(mutation.module_path)
    mutated = mutate_code(source, get_operator(mutation.operator_name)(), mutation.occurrence)
    try:
        if mutated is None or _behaviour(source) == _behaviour(mutated):
            return None
    except SyntaxError:  # the ** of a dict display, taken for a power
        return None
    before, after = source.splitlines(), mutated.splitlines()
    matcher = difflib.SequenceMatcher(None, before, after, autojunk=False)
    edits = [edit for edit in matcher.get_opcodes() if edit[0] != "equal"]
    (_, first, _, _, _), (_, _, end, _, end_after) = edits[0], edits[-1]
    return Change(
        mutation.module_path.as_posix(), first + 1, "\n".join(before[first:end]), "\n".join(after[first:end_after])
    )


@cache
def _source(path: Path) -> str:
    source: str = read_python_source(path)
    return source


@lru_cache(256)
def _behaviour(source: str) -> str:
    """Return the syntax tree of `source` without annotations, decorators and the kinds of parameters."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            node.returns, node.decorator_list = None, []
        elif isinstance(node, ast.ClassDef):
            node.decorator_list = []
        elif isinstance(node, ast.arg):
            node.annotation = None
        elif isinstance(node, ast.AnnAssign):
            node.annotation = ast.Constant(None)
        elif isinstance(node, ast.arguments):
            node.args = [*node.posonlyargs, *node.args, *node.kwonlyargs]
            node.defaults += [default for default in node.kw_defaults if default]
            node.posonlyargs, node.kwonlyargs, node.kw_defaults = [], [], []
    return ast.dump(tree)


def _judge(chosen: list[tuple[WorkItem, Change]]) -> int:
    """Run the tests of each mutant, list the survivors, and tell the share that was noticed."""
    if not chosen:
        raise InputError("no mutant in these paths: name files or folders with Python code")
    noticed = judged = 0
    SESSION.unlink(missing_ok=True)
    with use_db(SESSION) as session, progress("mutants", len(chosen)) as bar:
        session.add_work_items(item for item, _ in chosen)
        try:
            for item, change in chosen:
                patience_s = _patience_s(_folder(change.path))
                with _kernels():
                    result: WorkResult = mutate_and_test(item.mutations, _command(change.path), patience_s)
                if result.worker_outcome is not WorkerOutcome.NORMAL:
                    raise RunError(f"{change.path}:{change.line}: no such mutant can be made: {result.output}")
                session.set_result(item.job_id, result)
                bar.advance()
                judged += 1
                noticed += result.is_killed
                if not result.is_killed:
                    lines = [f"  - {line}" for line in change.before.split("\n")]
                    lines += [f"  + {line}" for line in change.after.split("\n")]
                    print(f"{change.path}:{change.line}", *lines, sep="\n", flush=True)
        finally:
            print(f"{noticed} of {judged} mutants noticed, {noticed / max(judged, 1):.0%}")
    return 0


@cache
def _patience_s(folder: str) -> float:
    """Run the tests of a folder of code without a fault, and return how long those of a mutant may take."""
    os.environ["NUMBA_CACHE_DIR"] = str(KERNELS)
    began_s = time.monotonic()
    outcome, output = run_tests(_command(f"{folder}/any"), None)
    if outcome is not TestOutcome.SURVIVED:
        raise RunError(f"{output}\nthe tests of {folder} fail without any fault: mend them first")
    return max(LEAST_PATIENCE_S, PATIENCE * (time.monotonic() - began_s))


@contextmanager
def _kernels() -> Iterator[None]:
    """Give a mutant a copy of the compiled kernels, so that no kernel with a fault is left for the next one."""
    with TemporaryDirectory(dir=FOLDER) as own:
        if KERNELS.exists():
            shutil.copytree(KERNELS, own, dirs_exist_ok=True)
        os.environ["NUMBA_CACHE_DIR"] = own
        yield


def _folder(path: str) -> str:
    """Return the folder of tests that judge a file of code."""
    return path.split("/", maxsplit=1)[0]


def _command(path: str) -> str:
    """Return the command that judges a file: the tests of its folder but for slow ones, those that name it first."""
    folder, module = _folder(path), path.removesuffix(".py").replace("/", ".")
    if not any(Path("tests", folder).rglob("test_*.py")):
        raise InputError(f"no tests judge {folder}/: tests/{folder} has none; name other files or folders")
    tests = sorted(
        Path("tests", folder).rglob("test_*.py"),
        key=lambda test: (test.stem != f"test_{Path(path).stem}", module not in test.read_text(), test),
    )
    options = "-x -q -p no:cacheprovider -m 'not slow' --hypothesis-seed=0"
    return f"{shlex.quote(sys.executable)} -m pytest {options} {shlex.join(map(str, tests))}"


if __name__ == "__main__":
    sys.exit(main())
