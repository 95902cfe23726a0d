"""Tables, the progress bar and ``--json``, as every verb shows them."""

import json

import numpy as np
import pytest
from cyclopts import App

from shell.terminal import Json, print_json, print_table, progress


def test_a_row_is_a_line_and_nothing_is_cut_off(capsys: pytest.CaptureFixture[str]) -> None:
    name = "a long name of an object " * 20
    print_table(["object", "force mN", "sender"], [[name, 1.5, "gateway"], ["[red]ring", None, 12.25]], title="touches")
    title, headings, *rows = capsys.readouterr().out.splitlines()
    assert title == "touches"
    assert headings.split() == ["object", "force", "mN", "sender"]
    assert rows[0].split(name.strip())[1].split() == ["1.5", "gateway"]
    assert rows[1].split() == ["[red]ring", "12.25"]
    assert rows[1] == rows[1].rstrip()


def test_numbers_stand_right_and_words_left(capsys: pytest.CaptureFixture[str]) -> None:
    print_table(["", "Hz", "what"], [["a", "1.5", "TPDO"], ["b", "none", "SYNC 2"], ["c", "-100.5", ""]])
    assert capsys.readouterr().out == "       Hz  what\na     1.5  TPDO\nb    none  SYNC 2\nc  -100.5\n"


def test_rows_without_headings(capsys: pytest.CaptureFixture[str]) -> None:
    print_table([], [["cycles", "10 of 10"], ["load", "76 %"]])
    assert capsys.readouterr().out == "cycles  10 of 10\nload    76 %\n"
    print_table(["object"], [])
    assert capsys.readouterr().out == "object\n"


def test_json_is_one_line_a_program_reads(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"Φ": [1.5, None, float("nan"), np.float64(2), np.int16(3), np.bool_(True)]})
    out = capsys.readouterr().out
    assert out.count("\n") == 1
    assert json.loads(out) == {"Φ": [1.5, None, None, 2.0, 3, True]}
    with pytest.raises(TypeError, match="no JSON for a set_iterator"):
        print_json(iter({1}))


def test_the_flag_is_json_and_has_no_opposite() -> None:
    def verb(*, json: Json = False) -> bool:
        return json

    app = App(result_action="return_value")
    app.default(verb)
    assert app(["--json"], exit_on_error=False) is True
    assert app([], exit_on_error=False) is False
    with pytest.raises(Exception, match="--no-json"):
        app(["--no-json"], exit_on_error=False, print_error=False)


def test_without_a_terminal_only_printed_lines_show(capsys: pytest.CaptureFixture[str]) -> None:
    with progress("measuring", 3, done=1) as bar:
        bar.advance()
        bar.update(3, "packing")
        bar.print("node 5 [was] started again")
    with progress("timing", None):
        pass
    out, err = capsys.readouterr()
    assert out == ""
    assert err == "node 5 [was] started again\n"


def test_on_a_terminal_the_bar_counts(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "100")
    with progress("measuring", 40, done=2) as bar:
        bar.advance()
    err = capsys.readouterr().err
    assert "measuring" in err
    assert "3/40" in err
