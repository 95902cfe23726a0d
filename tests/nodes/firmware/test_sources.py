"""The C sources: they compile without a warning, hold the dictionary, and no frame breaks a board's memory."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from canskin.errors import InputError
from dbc import indices as od
from dbc.configuration import setting_of
from dbc.contract import Contract
from dbc.dictionary import dictionary
from dbc.generate import write_files
from nodes.firmware.export import constants, export_files, sources
from nodes.firmware.library import STANDARD_FLAGS, Firmware, compile_c
from nodes.firmware.tables import builds
from skin.layout import load_layout
from tests.layouts import buses
from tests.nodes.firmware.stack import HERE, STACK, compile_adapter, exported
from tests.nodes.firmware.twins import needs_compiler, small_contract

NAMES = ("default", "fd", "one-bus-12bit", "adaptive", "adaptive-fd")
#: Bursts of random frames, and seeds.
BURSTS, SEEDS = 20_000, range(1, 4)
#: Adaptive boards filter a sample beside each burst.
ADAPTIVE_BURSTS = 3000
ARM = "arm-none-eabi-gcc"
CORTEX_M0_PLUS = ("-mcpu=cortex-m0plus", "-mthumb", "-Os")
#: Flash memory of the sums, and of sums and slave with the constants of one board, bytes.
SUMS_BYTES, SLAVE_BYTES = 1024, 14 * 1024
#: Runs a program without a limit of its memory: a sanitizer reserves more than any machine has.
UNLIMITED = 'ulimit -S -d "$(ulimit -H -d)" && exec "$0" "$@"'
SANITIZERS = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def contract_of(name: str) -> Contract:
    return Contract.from_layout(load_layout(Path(name)))


@pytest.mark.heavy
@needs_compiler
@pytest.mark.parametrize("name", NAMES)
def test_an_exported_board_compiles_without_a_warning(name: str, tmp_path: Path) -> None:
    board = exported(contract_of(name), tmp_path)
    main = tmp_path / "main.c"
    main.write_text("int main(void)\n{\n    return 0;\n}\n")
    parts = [*tmp_path.glob("src/*.[ch]"), *tmp_path.glob("src/slave/*.[ch]"), *tmp_path.glob("src/adaptive/*.[ch]")]
    parts += [path for path in board.iterdir() if not path.name.startswith("OD")]
    compile_c([*parts, main], tmp_path / "firmware", ["cc", *STANDARD_FLAGS, "-O2"])


@pytest.mark.heavy
@needs_compiler
@pytest.mark.parametrize("name", NAMES)
def test_the_adapter_for_canopennode_compiles_without_a_warning(name: str, tmp_path: Path) -> None:
    assert compile_adapter(contract_of(name), tmp_path, "print_dictionary.c").exists()


@pytest.mark.heavy
@needs_compiler
@pytest.mark.parametrize("name", NAMES)
def test_the_dictionary_for_canopennode_is_that_of_the_contract(name: str, tmp_path: Path) -> None:
    contract = contract_of(name)
    board = exported(contract, tmp_path)
    program = tmp_path / "print_dictionary"
    command = ["cc", *STANDARD_FLAGS, f"-I{STACK}"]
    compile_c([HERE / "print_dictionary.c", board / "OD.c", board / "OD.h"], program, command)
    printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout.splitlines()
    expected = []
    for each in dictionary(contract, contract.nodes[0]):
        attribute = 0x03 if each.access == "rw" else 0x01
        attribute |= 0x04 if each.pdo else 0
        attribute |= 0x80 if each.data_type == od.VISIBLE_STRING else 0x40 if od.BITS[each.data_type] > 8 else 0
        data = setting_of(each).data.hex()
        value = "--" * (len(data) // 2) if each.index == od.ERROR_FIELD else data  # the stack's own
        expected.append(f"{each.index:04X} {each.subindex or 0} {attribute:02X} {value}")
    assert printed == expected


@pytest.mark.skipif(shutil.which(ARM) is None, reason=f"NOT TESTED: no {ARM}")
def test_a_cortex_m0_plus_holds_sums_and_slave(tmp_path: Path) -> None:
    board = exported(contract_of("default"), tmp_path)
    texts = [*tmp_path.glob("src/*.c"), *tmp_path.glob("src/slave/*.c"), board / "board.c"]
    folders = [f"-I{each}" for each in (tmp_path / "src", tmp_path / "src/slave", board)]
    sizes = {}
    for text in texts:
        made = tmp_path / f"{text.stem}.o"
        command = [ARM, *STANDARD_FLAGS, *CORTEX_M0_PLUS, *folders, "-c", str(text), "-o", str(made)]
        subprocess.run(command, check=True)
        line = subprocess.run(["arm-none-eabi-size", made], capture_output=True, text=True, check=True).stdout
        sizes[text.stem] = sum(map(int, line.splitlines()[1].split()[:2]))
    print(sizes)
    assert sizes["skin_sums"] < SUMS_BYTES
    assert sum(sizes.values()) < SLAVE_BYTES


FUZZED = {
    "classic": small_contract,
    "fd": lambda: small_contract(encoding={"sum_bits": 12}, bus=buses(1, 1, blocks_per_node=2, fd=True)),
    "adaptive": lambda: contract_of("adaptive"),
    "adaptive-fd": lambda: contract_of("adaptive-fd"),
}


@pytest.mark.heavy
@needs_compiler
@pytest.mark.parametrize("name", FUZZED)
def test_random_frames_break_nothing(name: str, tmp_path: Path) -> None:
    contract = FUZZED[name]()
    boards = builds(contract, contract.on_bus(0)[:2])
    texts = sources(boards, "slave", "host") | constants(contract, boards)
    program = tmp_path / "fuzz"
    try:
        paths = [*write_files(texts, tmp_path), HERE / "fuzz.c"]
        compile_c(paths, program, ["cc", *STANDARD_FLAGS, *SANITIZERS])
    except InputError as error:
        if "san" in str(error):
            pytest.skip("NOT TESTED: the compiler has no sanitizers")
        raise
    bursts = ADAPTIVE_BURSTS if contract.layout.sending == "adaptive" else BURSTS
    for seed in SEEDS:
        # The memory of a program that preloads a library cannot be watched.
        environment = {key: value for key, value in os.environ.items() if key != "LD_PRELOAD"}
        done = subprocess.run(
            ["sh", "-c", UNLIMITED, program, str(seed), str(bursts)],
            capture_output=True,
            text=True,
            check=False,
            env=environment,
        )
        assert done.returncode == 0, done.stderr + done.stdout


@pytest.mark.heavy
@needs_compiler
def test_a_damaged_library_in_the_cache_is_made_anew(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    contract, first, damaged = small_contract(), tmp_path / "first", tmp_path / "damaged"
    monkeypatch.setenv("SKIN_CACHE", str(first))
    Firmware(contract, contract.nodes)
    (kept,) = first.glob("*.so")
    damaged.mkdir()
    damaged.joinpath(kept.name).write_bytes(b"damaged")
    monkeypatch.setenv("SKIN_CACHE", str(damaged))
    Firmware(contract, contract.nodes)
    assert damaged.joinpath(kept.name).stat().st_size == kept.stat().st_size


def test_boards_that_make_sums_in_hardware_are_refused() -> None:
    contract = Contract.from_layout(load_layout(Path("analogue")))
    with pytest.raises(InputError, match="the C firmware adds taxels that are digital"):
        export_files(contract, contract.nodes[:1])


def test_a_machine_without_compiler_is_told() -> None:
    contract = small_contract()
    with pytest.raises(InputError, match="expected a C compiler as 'no-such-cc'"):
        Firmware(contract, contract.nodes, compiler="no-such-cc")
