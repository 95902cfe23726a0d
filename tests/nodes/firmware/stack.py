"""Exported boards, alone and behind CANopenNode's functions, without the stack itself."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from dbc.contract import Contract, NodeContract
from dbc.generate import write_files
from nodes.firmware.export import export_files
from nodes.firmware.library import STANDARD_FLAGS, compile_c

HERE: Final = Path(__file__).parent / "c"
STACK: Final = HERE / "stack"
#: For programs that run shortly; for warnings, which need the flow of data, `OPTIMIZED`.
QUICK: Final = "-O0"
OPTIMIZED: Final = "-O2"


def exported(contract: Contract, folder: Path, nodes: Sequence[NodeContract] | None = None) -> Path:
    """Export the first board or `nodes` of one type into `folder`; return the folder of the constants."""
    write_files(export_files(contract, nodes or contract.nodes[:1]), folder)
    (constants,) = folder.joinpath("boards").iterdir()
    return constants


def compile_slave(
    contract: Contract,
    folder: Path,
    main: str | Path,
    nodes: Sequence[NodeContract] | None = None,
    optimization: str = QUICK,
) -> Path:
    """Compile exported boards, the slave and a main program, of `HERE` or elsewhere; return the program."""
    constants = exported(contract, folder, nodes)
    texts = [*folder.glob("src/*.[ch]"), *folder.glob("src/slave/*.[ch]"), *folder.glob("src/steps/*.[ch]")]
    texts.append(HERE / main)
    texts += [path for path in constants.iterdir() if not path.name.startswith("OD")]
    compile_c(texts, folder / "firmware", ["cc", *STANDARD_FLAGS, optimization])
    return folder / "firmware"


def compile_adapter(
    contract: Contract,
    folder: Path,
    main: str,
    nodes: Sequence[NodeContract] | None = None,
    optimization: str = QUICK,
) -> Path:
    """Compile exported boards, their adapter and a main program (``BEHIND_STACK`` is defined); return the program."""
    constants = exported(contract, folder, nodes)
    texts = [*folder.glob("src/*.[ch]"), *folder.glob("src/steps/*.[ch]"), *folder.glob("src/canopennode/*.[ch]")]
    texts += [*constants.iterdir(), STACK / "dictionary.c", HERE / main]
    command = ["cc", *STANDARD_FLAGS, optimization, f"-I{STACK}", "-DBEHIND_STACK"]
    program = folder / "adapter"
    compile_c(texts, program, command)
    return program
