"""Boards behind CANopenNode's functions, without the stack itself."""

from pathlib import Path
from typing import Final

from dbc.contract import Contract
from dbc.generate import write_files
from nodes.firmware.export import export_files
from nodes.firmware.library import STANDARD_FLAGS, compile_c

HERE: Final = Path(__file__).parent / "c"
STACK: Final = HERE / "stack"


def exported(contract: Contract, folder: Path) -> Path:
    """Export the first board into `folder`; return the folder of its constants."""
    write_files(export_files(contract, contract.nodes[:1]), folder)
    return next(folder.joinpath("boards").iterdir())


def compile_adapter(contract: Contract, folder: Path, main: str) -> Path:
    """Compile an exported board, its adapter and a main program; return the program."""
    constants = exported(contract, folder)
    texts = [*folder.glob("src/*.[ch]"), *folder.glob("src/adaptive/*.[ch]"), *folder.glob("src/canopennode/*.[ch]")]
    texts += [*constants.iterdir(), STACK / "dictionary.c", HERE / main]
    command = ["cc", *STANDARD_FLAGS, "-O2", f"-I{STACK}"]
    program = folder / "adapter"
    compile_c(texts, program, command)
    return program
