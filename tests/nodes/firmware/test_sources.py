"""The C sources: they compile without a warning, hold the dictionary, and no frame breaks a board's memory."""

import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from canskin.errors import InputError
from dbc import indices as od
from dbc.board import board
from dbc.configuration import setting_of
from dbc.contract import Contract, NodeContract
from dbc.dictionary import dictionary
from dbc.generate import write_files
from dbc.vectors import vectors_text
from nodes.firmware.export import constants, images, sources
from nodes.firmware.library import STANDARD_FLAGS, Firmware, compile_c
from nodes.firmware.tables import builds
from skin.layout import Sampling, changed, load_layout
from tests.layouts import buses
from tests.nodes.firmware.stack import HERE, OPTIMIZED, compile_adapter, compile_slave, exported
from tests.nodes.firmware.twins import analogue, few_sums, needs_compiler, small_contract

#: Bursts of random frames, and seeds.
BURSTS, SEEDS = 20_000, range(1, 4)
#: Stepped boards filter a sample beside each burst.
STEPPED_BURSTS = 3000
ARM = "arm-none-eabi-gcc"
CORTEX_M0_PLUS = ("-mcpu=cortex-m0plus", "-mthumb", "-Os")
#: Flash memory, bytes: of the sums; of the whole slave with one board; of a further board.
SUMS_BYTES, SLAVE_BYTES, BOARD_BYTES = 1024, 17_000, 110
#: Runs a program without a limit of its memory: a sanitizer reserves more than any machine has.
UNLIMITED = 'ulimit -S -d "$(ulimit -H -d)" && exec "$0" "$@"'
SANITIZERS = ("-g1", "-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def contract_of(name: str) -> Contract:
    return Contract.from_layout(load_layout(Path(name)))


def some_of(contract: Contract) -> list[NodeContract]:
    """Return the first, a middle and the last node."""
    return [contract.nodes[place] for place in (0, len(contract.nodes) // 2, -1)]


@pytest.mark.parametrize("name", ["default", "steps"])
def test_no_two_files_of_the_slave_call_each_other_in_a_circle(name: str) -> None:
    contract = contract_of(name)
    texts = sources(builds(contract, contract.nodes[:1]), "slave", "host")
    other = "skin_tpdos.c" if name == "steps" else "skin_stepped.c"  # empty for these boards
    files = {path: text for path, text in texts.items() if path.endswith(".c") and not path.endswith(other)}
    home = {
        name: path
        for path, text in files.items()
        for name in re.findall(r"^\w[^;(=]*?\b(skin_\w+)\([^;]*?\n{", text, re.MULTILINE)
    }
    assert len(home) > 50
    called = {
        path: {home.get(name, path) for name in re.findall(r"\b(skin_\w+)\(", text)} - {path}
        for path, text in files.items()
    }
    list(TopologicalSorter(called).static_order())


@pytest.mark.heavy
@needs_compiler
@pytest.mark.parametrize("name", ["fd", "one-bus-12bit", "analogue", "steps-fd"])
def test_one_image_for_canopennode_has_the_dictionary_of_each_board(name: str, tmp_path: Path) -> None:
    contract = contract_of(name)
    program = compile_adapter(contract, tmp_path, "print_dictionary.c", contract.nodes, OPTIMIZED)
    for node in some_of(contract):
        assert printed(program, str(node.bus), str(node.node_id)) == expected_dictionary(contract, node)
    assert subprocess.run([program, "0", "127"], check=False, stdout=subprocess.DEVNULL).returncode == 1


def printed(program: Path, *arguments: str) -> list[str]:
    return subprocess.run([program, *arguments], capture_output=True, text=True, check=True).stdout.splitlines()


def expected_dictionary(contract: Contract, node: NodeContract) -> list[str]:
    """Return a line for each object, and the signature."""
    expected = []
    for each in dictionary(contract, node):
        if od.is_program_download(each.index):
            continue
        attribute = 0x03 if each.access == "rw" else 0x01
        attribute |= (0x0C if each.access == "rw" else 0x04) if each.pdo else 0
        attribute |= 0x80 if each.data_type == od.VISIBLE_STRING else 0x40 if od.BITS[each.data_type] > 8 else 0
        data = setting_of(each).data.hex()
        value = "--" * (len(data) // 2) if each.index == od.ERROR_FIELD else data  # the stack's own
        expected.append(f"{each.index:04X} {each.subindex or 0} {attribute:02X} {value}")
    return [*expected, str(board(contract, node).signature)]


@pytest.mark.heavy
@needs_compiler
@pytest.mark.parametrize("compiled", [compile_slave, compile_adapter])
@pytest.mark.parametrize(
    ("name", "tables"),
    [
        ("fd", {}),
        ("one-bus-12bit", {}),
        ("forearm", {"sync": {"turns": 2}, "encoding": {"sum_bits": 7}}),
        ("analogue", {"sync": {"turns": 2}}),
    ],
)
def test_one_image_sends_the_frames_of_the_vectors_as_each_of_several_boards(
    name: str, tables: dict[str, Any], compiled: Callable[..., Path], tmp_path: Path
) -> None:
    # Averages depend on what came before.
    contract = Contract.from_layout(changed(load_layout(Path(name)), sampling=Sampling(), **tables))
    program = compiled(contract, tmp_path, "run_board.c", contract.nodes)
    for node in some_of(contract):
        cases = json.loads(vectors_text(contract, node))["cases"]
        lines = [" ".join(map(str, [case["pattern"], case["sync_counter"], *read_by_place(case)])) for case in cases]
        command = [program, str(node.bus), str(node.node_id), str(contract.turns)]
        done = subprocess.run(command, input="\n".join(lines), capture_output=True, text=True, check=True)
        signature, *sent = done.stdout.splitlines()
        assert int(signature) == board(contract, node).signature
        for case, line in zip(cases, sent, strict=True):
            assert set(line.split()) == {f"{each['cob_id']}:{each['data']}" for each in case["frames"]}, case["name"]


def read_by_place(case: dict[str, Any]) -> list[int]:
    """Return count, bits of the gain, and offset of each place of all blocks; nothing of an analogue board."""
    if "counts" not in case:
        return []
    counts, gain, offset = (np.ravel(case[key]) for key in ("counts", "gain", "offset_counts"))
    table = np.stack([counts, gain.astype(np.float32).view(np.uint32), offset], axis=1)
    return table.astype(int).ravel().tolist()  # type: ignore[no-any-return]


def test_an_export_has_a_program_for_each_type_of_board_or_for_the_chosen_one() -> None:
    def folders(contract: Contract, nodes: Sequence[NodeContract]) -> dict[str, list[int]]:
        found = images(contract, builds(contract, nodes)).items()
        return {name: [each.node.node_id for each in image] for name, image in found}

    contract = small_contract()
    assert folders(contract, contract.nodes) == {"all": [1, 2, 1, 2]}
    assert folders(contract, contract.nodes[1:2]) == {"bus0-002": [2]}
    unequal = few_sums(buses(2, 2))
    assert folders(unequal, unequal.nodes) == {"type-1": [1, 2, 1], "bus1-002": [2]}


@pytest.mark.skipif(shutil.which(ARM) is None, reason=f"NOT TESTED: no {ARM}")
def test_a_cortex_m0_plus_holds_sums_and_slave(tmp_path: Path) -> None:
    contract = contract_of("default")
    sizes, more = (flash_bytes(contract, tmp_path / str(count), count) for count in (1, 33))
    assert sizes["skin_sums"] < SUMS_BYTES
    assert sum(sizes.values()) < SLAVE_BYTES
    assert more["board"] - sizes["board"] <= 32 * BOARD_BYTES + 8  # whole words
    assert f"{BOARD_BYTES} bytes a board" in (tmp_path / "33/README.md").read_text()


def flash_bytes(contract: Contract, folder: Path, count: int) -> dict[str, int]:
    """Return the bytes of each object file of an image with the first `count` boards."""
    board = exported(contract, folder, contract.nodes[:count])
    texts = [*folder.glob("src/*.c"), *folder.glob("src/slave/*.c"), board / "board.c"]
    folders = [f"-I{each}" for each in (folder / "src", folder / "src/slave", board)]
    sizes = {}
    for text in texts:
        made = folder / f"{text.stem}.o"
        command = [ARM, *STANDARD_FLAGS, *CORTEX_M0_PLUS, *folders, "-c", str(text), "-o", str(made)]
        subprocess.run(command, check=True)
        line = subprocess.run(["arm-none-eabi-size", made], capture_output=True, text=True, check=True).stdout
        sizes[text.stem] = sum(map(int, line.splitlines()[1].split()[:2]))
    print(sizes)
    return sizes


FUZZED = {
    "classic": small_contract,
    "fd": lambda: small_contract(encoding={"sum_bits": 12}, bus=buses(1, 1, blocks_per_node=2, fd=True)),
    "analogue": analogue,
    "steps": lambda: contract_of("steps"),
    "steps-fd": lambda: contract_of("steps-fd"),
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
    bursts = STEPPED_BURSTS if contract.layout.sending == "steps" else BURSTS
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


def test_a_machine_without_compiler_is_told() -> None:
    contract = small_contract()
    with pytest.raises(InputError, match="expected a C compiler as 'no-such-cc'"):
        Firmware(contract, contract.nodes, compiler="no-such-cc")
