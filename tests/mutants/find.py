"""Draw small faults, and tell the share that the tests notice: `make mutants`, explained in docs/develop.md.

cosmic-ray makes the mutants of ``cosmic-ray.toml`` in a copy of the tree, and runs ``judge`` on each.
``cr-report --show-output build/mutants/session.sqlite`` shows what the tests said.
"""

import argparse
import os
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, Final

from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.config import load_config
from cosmic_ray.modules import find_modules
from cosmic_ray.plugins import get_operator, operator_names
from cosmic_ray.work_db import use_db
from cosmic_ray.work_item import MutationSpec, WorkerOutcome, WorkItem
from parso.tree import search_ancestor

ROOT: Final = Path(__file__).parents[2]
FOLDER: Final = ROOT / "build" / "mutants"
#: The tree that is changed.
COPY: Final = FOLDER / "tree"
SESSION: Final = FOLDER / "session.sqlite"
CONFIGURATION: Final = "tests/mutants/cosmic-ray.toml"


def main() -> int:
    """Judge a sample of mutants; return 1 if fewer than nine of ten are noticed."""
    parser = argparse.ArgumentParser(prog="make mutants", description="find faults that no test notices")
    parser.add_argument("--sample", type=int, default=100, help="mutants that are drawn (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the draw (default: %(default)s)")
    parser.add_argument("--only", default="", metavar="PATH", help="a file or folder of those in cosmic-ray.toml")
    options = parser.parse_args()
    copy_tree()
    os.chdir(COPY)
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    os.environ["PYTHONPATH"] = os.pathsep.join((str(COPY), str(COPY / "client")))
    draw(options.sample, options.seed, options.only)
    subprocess.run(["cosmic-ray", "exec", CONFIGURATION, str(SESSION)], check=True)
    return tell()


def copy_tree() -> None:
    """Copy our files, also those that are not committed, into a repository whose changes are the mutant's."""
    shutil.rmtree(COPY, ignore_errors=True)
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    for name in subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout.split("\0"):
        if name and (ROOT / name).is_file():
            (COPY / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, COPY / name)
    for command in ("init --quiet", "add --all", "-c user.name=mutants -c user.email=mutants commit --quiet -m tree"):
        subprocess.run(["git", *command.split()], cwd=COPY, check=True)


def draw(count: int, seed: int, only: str) -> None:
    """Draw `count` mutants below the path `only`, of the operators that ``cosmic-ray.toml`` does not exclude."""
    config = load_config(COPY / CONFIGURATION)
    excluded = re.compile("|".join(config.sub("filters", "operators-filter")["exclude-operators"]))
    operators = [name for name in sorted(operator_names()) if not excluded.match(name)]
    wanted = [
        WorkItem.single(f"{file} {name} {occurrence}", MutationSpec(file, name, occurrence, *place))
        for file in sorted(find_modules([Path(path) for path in config["module-path"]]))
        if str(file).startswith(only) and str(file) not in config["excluded-modules"]
        for name in operators
        for occurrence, place in places(file, name)
    ]
    drawn = random.Random(seed).sample(wanted, min(count, len(wanted)))
    SESSION.unlink(missing_ok=True)
    with use_db(SESSION) as session:
        session.add_work_items(drawn)
    print(f"{len(drawn)} of {len(wanted)} mutants", flush=True)


@cache
def nodes_of(file: Path) -> list[Any]:
    """Return the nodes of a file."""
    return list(ast_nodes(get_ast_from_path(file)))


def places(file: Path, operator: str) -> Iterator[tuple[int, tuple[tuple[int, int], tuple[int, int]]]]:
    """Yield number and place of what an operator changes in a file, but for places that change no result.

    Those are decorators, which tell how a function is compiled and kept, and the question whether types are checked.
    """
    make = get_operator(operator)()
    found = ((node, place) for node in nodes_of(file) for place in make.mutation_positions(node))
    for number, (node, place) in enumerate(found):
        if search_ancestor(node, "decorator") is None and not node.get_code().strip().startswith("if TYPE_CHECKING:"):
            yield number, place


def tell() -> int:
    """Print the mutants that no test noticed, and the share that was."""
    with use_db(SESSION) as session:
        of_job = {item.job_id: item.mutations[0] for item in session.work_items}
        ended = [(of_job[job], each) for job, each in session.results if each.worker_outcome is WorkerOutcome.NORMAL]
    # cosmic-ray calls tests that were too slow a fault that was noticed.
    judged = [(mutation, each) for mutation, each in ended if each.output != "timeout"]
    survived = [(mutation, each) for mutation, each in judged if not each.is_killed]
    for mutation, each in survived:
        print(f"{mutation.module_path}:{mutation.start_pos[0]} {mutation.operator_name}\n{each.diff}")
    noticed = 1 - len(survived) / max(1, len(judged))
    print(f"{len(judged) - len(survived)} of {len(judged)} mutants noticed, {noticed:.0%}")
    return int(noticed < 0.9)


if __name__ == "__main__":
    sys.exit(main())
