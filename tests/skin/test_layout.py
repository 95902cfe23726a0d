"""The layout file: what it means, and errors that name the path of the wrong key."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canskin.errors import InputError, LayoutError
from skin.layout import (
    SHIPPED,
    Bus,
    Layout,
    PhiParameters,
    Sync,
    Taxels,
    changed,
    layout_text,
    load_layout,
    parse_layout,
    require_sending,
    validated,
)
from tests.layouts import STEPPED, TWO_FINGERS, in_one_instant, small_layout

DEFAULT = Path(__file__).parents[2].joinpath("skin/layouts/default.toml").read_text()


def test_default_skin() -> None:
    layout = load_layout()
    assert layout.taxels.count == 4096
    assert layout.taxels.newton_per_count == pytest.approx(0.02 / 1023)
    assert layout.blocks == 128
    assert [bus.nodes for bus in layout.bus] == [32] * 4
    assert (layout.sync.rate_hz, layout.sync.turns, layout.samples_per_sync) == (200.0, 2, 5)
    assert not layout.is_of_one_instant
    assert layout.phi().shape == (1024, 4096)
    assert (layout.phi().kept.sum(axis=1) == 8).all()


def test_same_layout_same_phi_and_another_seed_another() -> None:
    layout = load_layout()
    other = msgspec.structs.replace(layout, measurement=msgspec.structs.replace(layout.measurement, seed=2))
    assert layout.phi().fingerprint == load_layout().phi().fingerprint
    assert other.phi().fingerprint != layout.phi().fingerprint


@pytest.mark.parametrize(
    ("old", "new", "path"),
    [
        ("rows = 64\ncolumns = 64", "rows = 1\ncolumns = 7", "$.taxels"),
        ("adc_bits = 10", "adc_bits = 17", "$.taxels.adc_bits"),
        ("block_size = 32", "block_size = 33", "$.measurement.block_size"),
        ("sums = 1024", "sums = 1000", "$.measurement.sums"),
        ("sums = 1024", "sums = 0", "$.measurement.sums"),
        ("sums = 1024", "sums = 2\nrows = [[0, 1]]", "$.measurement.sums"),
        ("sums = 1024", "rows = [[0, 1], [0, 1]]", "$.measurement.rows"),
        ("sums = 1024", "rows = [[128, 0]]", "$.measurement.rows"),
        ("sums = 1024", "rows = [[0, 32]]", "$.measurement.rows"),
        ("sums = 1024", "rows = []", "$.measurement.rows"),
        ("sums = 1024", "rows = [[0]]", "$.measurement.rows[0]"),
        ("[taxels]", "[taxels]\nuntouchable = [4096]", "$.taxels.untouchable"),
        ("[taxels]", "[taxels]\nuntouchable = [0, -1]", "$.taxels.untouchable"),
        ("[taxels]", "[taxels]\nuntouchable = [7, 3, 7]", "$.taxels.untouchable"),
        ("[taxels]", f"[taxels]\nuntouchable = {list(range(4096))}", "$.taxels.untouchable"),
        ("[taxels]", "[taxels]\nuntouchable = [1.5]", "$.taxels.untouchable[0]"),
        ("[taxels]", "[taxels]\nmasked = [4096]", "$.taxels.masked"),
        ("[taxels]", f"[taxels]\nmasked = {list(range(3000))}", "$.taxels.masked"),  # more than sums of blocks
        ("[taxels]", "[taxels]\nhas_thermometers = 1", "$.taxels.has_thermometers"),
        ('sums = 1024\nselection = "balanced"', 'rows = [[0, 1]]\nselection = "uniform"', "$.measurement.selection"),
        ("rate_hz = 200.0", "rate_hz = -1.0", "$.sync.rate_hz"),
        ("force_max_n = 0.02", "force_max_n = 1e308", "$.taxels.force_max_n"),
        ("[device]", "[device]\nvendor_id = 4294967296", "$.device.vendor_id"),
        ("[device]", "[device]\nfirst_serial = 4294967295", "$.device.first_serial"),
        ("turns = 2", "turns = 3", "$.sync.turns"),
        ("jitter_s = 0.0004", "jitter_s = 1.5", "$.device.jitter_s"),
        ("block_size = 32", "block_size = 256", "$.measurement.block_size"),
        ('name = "bus1"', 'name = "bus0"', "$.bus[1].name"),
        ('name = "bus1"', 'name = "bus1"\nblocks_per_node = 2', "$.bus"),
        ('name = "bus1"', 'name = "bus1"\ndata_bitrate = 5_000_000', "$.bus[1].data_bitrate"),
        ('name = "bus1"', 'name = "bus1"\nfd = true\ndata_bitrate = 500_000', "$.bus[1].data_bitrate"),
        ('name = "bus1"', 'name = "bus1"\nfd = true\ndata_bitrate = 9_000_000', "$.bus[1].data_bitrate"),
        ('name = "bus1"\nnodes = 32', 'name = "bus1"\nnodes = 31', "$.bus"),
        (
            'name = "bus1"\nnodes = 32\nbitrate = 1_000_000',
            'name = "bus1"\nnodes = 32\nbitrate = 2',
            "$.bus[1].bitrate",
        ),
    ],
)
def test_errors_name_the_path(old: str, new: str, path: str) -> None:
    assert old in DEFAULT
    with pytest.raises(LayoutError) as caught:
        parse_layout(DEFAULT.replace(old, new, 1).encode(), "palm.toml")
    assert f"at `{path}`" in str(caught.value)
    assert str(caught.value).startswith("palm.toml: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("more", ["", "wiring = 'board'"])
def test_layout_that_names_its_rows(more: str) -> None:
    def with_lines(lines: str) -> Layout:
        return parse_layout(DEFAULT.replace("sums = 1024", f"{lines}\n{more}").encode(), "palm.toml")

    named, drawn = with_lines("rows = [[127, 31], [3, 5], [3, 0]]"), with_lines("sums = 1024")
    assert named.measurement.sums == 3
    assert (named.phi().order == drawn.phi().order).all()
    rows = zip(named.phi().block_of_sum.tolist(), named.phi().row_of_sum.tolist(), strict=True)
    assert list(rows) == [(3, 0), (3, 5), (127, 31)]
    assert parse_layout(layout_text(named).encode(), "again") == named


@pytest.mark.parametrize(
    "content", [b"", b"[[bus]]\n", b"\xff\xfe", b"[taxels\n", b"a = 1\na = 2\n", b"a = " + 9999 * b"["]
)
def test_broken_files_are_layout_errors(content: bytes) -> None:
    with pytest.raises(LayoutError):
        parse_layout(content, "palm.toml")


def test_what_is_for_one_way_of_sending_refuses_the_other() -> None:
    require_sending(load_layout(), "synchronous", "a verb is", "no reason")
    with pytest.raises(InputError, match="a verb is for synchronous sending: the reason"):
        require_sending(load_layout(Path("steps")), "synchronous", "a verb is", "the reason")


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_layouts_are_known_by_their_names(name: str) -> None:
    layout = load_layout(Path(name))
    phi, default = layout.phi(), load_layout().phi()
    if phi.shape[1] == default.shape[1]:
        assert (phi.order == default.order).all() == (layout.sending == "synchronous")
        assert layout.blocks == 128
    assert (phi.fingerprint == default.fingerprint) == (layout.measurement.sums == 1024)
    assert layout.first_block(len(layout.bus)) == layout.blocks


def test_missing_file() -> None:
    with pytest.raises(LayoutError, match=r"no\.toml: cannot read the layout: No such file"):
        load_layout(Path("no.toml"))


def test_small_skin() -> None:
    text = '[taxels]\nrows = 16\ncolumns = 16\n[measurement]\nsums = 64\n[[bus]]\nname = "bus0"\nnodes = 8\n'
    layout: Layout = parse_layout(text.encode(), "small.toml")
    assert layout.phi().shape == (64, 256)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("sum_bits = 14", "sum_bits = 17", "expected 16 or less, got 17"),
        ("sum_bits = 14", "sum_bits = 6", "expected 7 or more, got 6"),
        (
            "[sync]",
            "[sync]\nidentity = 'window'",
            "the key `identity` went, because every frame now names its cycle: leave it out; logs and recordings of ",
        ),
        ('ensemble = "sbhe"', 'ensemble = "dct"', 'expected sbhe or matrix, got "dct"'),
        ('selection = "balanced"', 'selection = "any"', 'expected balanced or uniform, got "any"'),
        ('name = "bus1"', 'name = "bus1"\nblocks_per_node = 3', "expected 1 or 2 or 4 or 8, got 3"),
        ("rows = 64", "rowz = 64", "unknown key `rowz`: did you mean `rows`?"),
        ("[sync]", "[recognition]", "the key `recognition` went with the boards of two states"),
        ("[sync]", "[recognitions]", "unknown key `recognitions`: expected one of name, "),
        ("[taxels]", "[taxel]", "unknown key `taxel`: did you mean `taxels`?"),
        (
            "rows = 64",
            "height = 64",
            "unknown key `height`: expected one of shape, rows, columns, positions, link_ratio, pitch_m, ",
        ),
        ("rows = 64", "rows = '64'", 'expected a whole number, got "64" - at `$.taxels.rows`'),
        ("rows = 64", "rows = 6.5", "expected a whole number, got 6.5"),
        ("rows = 64", "rows = 0", "expected 1 or more, got 0"),
        ("pitch_m = 0.004", "pitch_m = inf", "expected 0.5 or less, got inf"),
        ("sum_bits = 14", "sum_bits = 14\noffset_binary = 1", "expected true or false, got 1"),
        ('name = "bus1"', 'name = "Bus 1"', 'begins with a letter, got "Bus 1" - at `$.bus[1].name`'),
        ('name = "bus1"', f'name = "{70 * "b"}"', "expected 64 characters or less, got 70"),
        ("nodes = 32", "", "the key `nodes` is missing - at `$.bus[0]`"),
        ("[sync]", "[encoding.sync]", "unknown key `sync`"),
    ],
)
def test_a_wrong_key_or_value_is_told_the_right_ones(old: str, new: str, says: str) -> None:
    assert old in DEFAULT
    with pytest.raises(LayoutError) as refused:
        parse_layout(DEFAULT.replace(old, new, 1).encode(), "x.toml")
    assert says in str(refused.value)


def test_sums_and_buses_follow_the_size_of_the_skin() -> None:
    small = parse_layout(b"[taxels]\nrows = 16\ncolumns = 16\n", "small.toml")
    assert (small.measurement.sums, [(bus.name, bus.nodes) for bus in small.bus]) == (128, [("bus0", 8)])
    assert parse_layout(b"[taxels]\n", "default.toml") == in_one_instant()
    least = parse_layout(b"[taxels]\nrows = 8\ncolumns = 8\n[measurement]\nblock_size = 2\n", "least.toml")
    assert (least.measurement.sums, least.blocks) == (64, 32)


def test_a_shipped_name_is_no_folder_of_that_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "fd").mkdir()
    monkeypatch.chdir(tmp_path)
    assert load_layout(Path("fd")).bus[0].fd


@pytest.mark.parametrize("name", SHIPPED)
def test_the_text_of_a_layout_is_read_as_the_same_layout(name: str) -> None:
    layout = load_layout(Path(name))
    assert parse_layout(layout_text(layout).encode(), name) == validated(layout) == layout


def test_a_layout_of_a_program_is_checked_like_a_file() -> None:
    layout = load_layout()
    with pytest.raises(LayoutError, match=r"\$\.sync\.rate_hz"):
        validated(msgspec.structs.replace(layout, sync=Sync(rate_hz=-1.0)))
    with pytest.raises(LayoutError, match=r"hold 96 blocks"):
        validated(msgspec.structs.replace(layout, bus=layout.bus[:3]))


def test_samples_between_syncs_are_averaged_and_the_table_survives_writing() -> None:
    single = parse_layout(b"[taxels]\n[sampling]\nrate_hz = 100.0\n", "single.toml")
    assert single.samples_per_sync == 1
    assert parse_layout(layout_text(single).encode(), "again.toml") == single
    default = in_one_instant()
    assert default.samples_per_sync == 10
    assert parse_layout(layout_text(default).encode(), "again.toml") == default
    odd = parse_layout(b"[taxels]\n[sync]\nrate_hz = 30.0\n[sampling]\nrate_hz = 1000.0\n", "odd.toml")
    assert odd.samples_per_sync == 33
    whole = parse_layout(b"[taxels]\n", "from a recording", is_whole=True)
    assert whole.samples_per_sync == 1


@given(st.integers(1, 40), st.integers(8, 40), st.sampled_from([8, 32, 64]), st.sampled_from(["scattered", "board"]))
@settings(max_examples=40, deadline=None)
def test_grids_of_any_size(rows: int, columns: int, block_size: int, wiring: str) -> None:
    lines = (
        f"[taxels]\nrows = {rows}\ncolumns = {columns}\n[measurement]\nblock_size = {block_size}\nwiring = '{wiring}'"
    )
    layout = parse_layout(lines.encode(), "mat.toml")
    phi = layout.phi()
    assert phi.shape == (layout.measurement.sums, rows * columns)
    assert layout.first_block(len(layout.bus)) == phi.blocks == -(-rows * columns // block_size)
    assert np.ptp([len(phi.taxels_of(block)) for block in range(phi.blocks)]) <= (1 if phi.empty else 0)
    assert parse_layout(layout_text(layout).encode(), "again.toml").phi().fingerprint == phi.fingerprint


def test_a_skin_of_several_patches() -> None:
    layout = small_layout(12, 14, **STEPPED, taxels={"shape": TWO_FINGERS})
    phi, cells = layout.phi(), np.array([list(line) for line in TWO_FINGERS])
    assert (layout.taxels.rows, layout.taxels.columns, layout.taxels.there) == (12, 14, 132)
    np.testing.assert_array_equal(phi.is_wired.reshape(12, 14), cells == "#")
    # Each finger of 36 taxels needs two boards of 32, and the five boards have room for no more: two reach further.
    assert phi.blocks == 5
    assert phi.empty == 5 * 32 - 132
    assert parse_layout(layout_text(layout).encode(), "again.toml") == layout


def test_a_board_has_no_gap() -> None:
    with pytest.raises(LayoutError, match="taxel 1 is a gap"):
        small_layout(
            2, 5, taxels={"shape": ["#.###", "#####"]}, measurement={"wiring": "file", "chains": [[*range(10)]]}
        )


@pytest.mark.parametrize("name", ["mat", "hand", "pad", "forearm"])
def test_the_wiring_does_not_depend_on_the_pitch(name: str) -> None:
    """Taxels as far from each other as others, but for the last bits of a length, are dealt out alike."""
    layout = load_layout(Path(name))
    measurement = msgspec.structs.replace(layout.measurement, wiring="board", chains=None)
    orders = []
    for pitch_m in (0.004, 0.0041, 0.005):
        taxels = layout.taxels
        if taxels.positions is None:
            taxels = msgspec.structs.replace(taxels, pitch_m=pitch_m)
        else:
            scaled = tuple(tuple(pitch_m * each for each in place[:3]) + place[3:] for place in taxels.positions)
            taxels = msgspec.structs.replace(taxels, positions=scaled)
        buses = [Bus(name="bus0", nodes=-(-taxels.there // measurement.block_size))]
        orders.append(msgspec.structs.replace(layout, taxels=taxels, measurement=measurement, bus=buses).phi().order)
    assert np.array_equal(orders[0], orders[1])
    assert np.array_equal(orders[0], orders[2])


def shaped(lines: str) -> str:
    return f"[taxels]\n{lines}\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "the key `bus` is missing"),
        ("bus = 3", "expected a list, of tables or values, got 3"),
        ("bus = []", "expected 1 table or more, got 0"),
        ("bus = [3]", "expected a table, got 3"),
        ("sync = 3\nbus = []", r"expected a table, got 3 - at `\$\.sync`"),
        (shaped("[sampling]\nrate_hz = 50.0"), r"or more, got 50 - at `\$\.sampling\.rate_hz`"),
        (shaped("shape = ['####', '####', '###']"), r"expected 4 signs, got 3 - at `\$\.taxels\.shape\[2\]`"),
        (
            shaped("shape = ['####', '#x##', '####']"),
            r"'#' for a taxel and '\.' for a gap, got 'x' - at `\$\.taxels\.sh",
        ),
        (shaped("rows = 2\nshape = ['####', '####', '####']"), r"expected 2 lines \(`rows`\), got 3"),
        (shaped("columns = 5\nshape = ['####', '####', '####']"), "expected 5 signs, got 4"),
        (shaped("shape = ['#...', '####']"), "expected 8 taxels or more, got 5"),
        (shaped("shape = []"), r"expected 64 lines \(`rows`\), got 0"),
        (shaped("positions = [[0, 0, 0]]"), r"expected 8 taxels or more, got 1 - at `\$\.taxels`"),
        (
            shaped(f"positions = {[[4 * x, 0, 0] for x in range(9)]}"),
            r"4 m apart: .* millimetres.* - at `\$\.taxels\.po",
        ),
    ],
)
def test_a_wrong_text_names_its_file_and_key(text: str, says: str) -> None:
    with pytest.raises(LayoutError, match=rf"x\.toml: .*{says}"):
        parse_layout(text.encode(), "x.toml")


def test_a_taxel_before_a_gap_can_be_untouchable() -> None:
    text = shaped("shape = ['####....'" + ", '########'" * 3 + "]\nuntouchable = [4]")
    assert parse_layout(text.encode(), "x.toml").taxels.untouchable == (4,)


def test_numbers_of_taxels_and_empty_places_fit_16_bits() -> None:
    chains = tuple((taxel,) for taxel in range(512))
    taxels = Taxels(shape=("#" * 256, "#" * 256, *["." * 256] * 253), rows=255, columns=256)
    measurement = PhiParameters(wiring="file", chains=chains, block_size=128, sums=512)
    layout = Layout(taxels=taxels, measurement=measurement, bus=[Bus(name=f"bus{k}", nodes=64) for k in range(8)])
    with pytest.raises(LayoutError, match="expected at most 65536 taxels, gaps and empty places, got 130304"):
        validated(layout)


@pytest.mark.parametrize(
    ("table", "key", "value"), [("encoding", "sum_bits", 12), ("measurement", "sums", 32), ("sync", "rate_hz", 40.0)]
)
def test_one_key_is_changed_and_nothing_else(table: str, key: str, value: float) -> None:
    layout = load_layout()
    before, after = msgspec.to_builtins(layout), msgspec.to_builtins(changed(layout, **{table: {key: value}}))
    before[table][key] = value
    assert after == before
