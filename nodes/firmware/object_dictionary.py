"""The object dictionary of a board in the form of CANopenNode V4: ``OD.h`` and ``OD.c``.

The stack asks for a list of entries by index. An entry describes a variable, an array or a record: a pointer to each
value, its length, and who may access it. Values that 1010h stores have a structure each for communication and
application; constants stay in flash memory.
"""

import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Final

from dbc import indices as od
from dbc.eds import storage_group
from dbc.objects import Object
from nodes.firmware.c_text import WRITTEN
from nodes.firmware.tables import Build, names

_TYPES: Final = {
    od.INTEGER8: "int8_t",
    od.INTEGER16: "int16_t",
    od.UNSIGNED8: "uint8_t",
    od.UNSIGNED16: "uint16_t",
    od.UNSIGNED32: "uint32_t",
    od.UNSIGNED56: "uint64_t",
    od.REAL32: "float",
    od.VISIBLE_STRING: "char",
}
#: Structures of the values (`dbc.eds.storage_group`), in their order; the last stays in flash memory.
_PLACES: Final = ("OD_PERSIST_COMM", "OD_PERSIST_APP", "OD_RAM", "OD_ROM")
_ROM: Final = _PLACES[-1]
#: Values that the stack keeps itself.
_OF_STACK: Final = (od.ERROR_FIELD,)


@dataclass(frozen=True)
class _Entry:
    """One index: its objects by sub-index, its name in C, and the structure that holds its values."""

    objects: tuple[Object, ...]
    name: str
    place: str

    @property
    def index(self) -> int:
        return self.objects[0].index

    @property
    def kind(self) -> str:
        first = self.objects[0]
        return "VAR" if first.subindex is None else "ARR" if first.array else "REC"

    @property
    def member(self) -> str:
        return f"x{self.index:04X}_{self.name}"


def od_header(boards: Sequence[Build]) -> str:
    """Return ``OD.h`` of boards of one type."""
    entries = _entries(boards)
    counts = {
        **dict.fromkeys(("NMT", "EM", "EM_PROD", "SYNC", "HB_CONS", "HB_PROD", "SDO_SRV", "STORAGE"), 1),
        "TPDO": sum(od.TPDO_COMMUNICATION <= each.index < od.TPDO_MAPPING for each in entries),
        **{f"ARR_{index:04X}": _elements(entries, index) for index in (od.ERROR_FIELD, od.CONSUMER_HEARTBEAT)},
    }
    lines = [
        *_head(boards, "Object dictionary, declarations"),
        "#ifndef OD_H",
        "#define OD_H",
        "",
        "/* Objects that the stack counts, and elements of arrays. */",
        *(f"#define OD_CNT_{name} {count}" for name, count in counts.items()),
        "",
    ]
    for place in _places(entries):
        lines += [
            "typedef struct {",
            *(line for entry in entries if entry.place == place for line in _declaration(entry)),
            f"}} {place}_t;",
            "",
            *([f"#ifndef OD_ATTR_{place[3:]}", f"#define OD_ATTR_{place[3:]}", "#endif"] if place != _ROM else []),
            f"extern {_qualifier(place)}{place}_t {place};",
            "",
        ]
    lines += ["#ifndef OD_ATTR_OD", "#define OD_ATTR_OD", "#endif", "extern OD_ATTR_OD OD_t *OD;", ""]
    for row, entry in enumerate(entries):
        lines += [
            f"#define OD_ENTRY_H{entry.index:04X} &OD->list[{row}]",
            f"#define OD_ENTRY_H{entry.index:04X}_{entry.name} &OD->list[{row}]",
        ]
    return "\n".join([*lines, "", "#endif", ""])


def od_source(boards: Sequence[Build]) -> str:
    """Return ``OD.c`` of boards of one type, with the values of the first."""
    entries = _entries(boards)
    lines = [
        *_head(boards, "Object dictionary"),
        "#define OD_DEFINITION",
        '#include "301/CO_ODinterface.h"',
        '#include "OD.h"',
        "",
    ]
    for place in _places(entries):
        lines += [
            f"{_qualifier(place)}{place}_t {place} = {{",
            *(line for entry in entries if entry.place == place for line in _values(entry)),
            "};",
            "",
        ]
    lines += ["typedef struct {", *(_object_declaration(entry) for entry in entries), "} OD_objects_t;", ""]
    lines += ["static CO_PROGMEM OD_objects_t objects = {"]
    lines += [line for entry in entries for line in _object(entry)]
    lines += ["};", "", "/* Index, number of sub-indices, kind, object, extension. */"]
    lines += ["static OD_ATTR_OD OD_entry_t list[] = {"]
    lines += [
        f"    {{0x{entry.index:04X}, {len(entry.objects)}, ODT_{entry.kind}, &objects.{entry.member}, NULL}},"
        for entry in entries
    ]
    lines += [
        "    {0, 0, 0, NULL, NULL},",
        "};",
        "",
        "static OD_t dictionary = {sizeof list / sizeof list[0] - 1, list};",
        "OD_t *OD = &dictionary;",
        "",
    ]
    return "\n".join(lines)


def _head(boards: Sequence[Build], what: str) -> list[str]:
    return [f"/* {what} of {names(boards)}, for CANopenNode V4. {WRITTEN} */"]


def _entries(boards: Sequence[Build]) -> list[_Entry]:
    table = boards[0].objects
    differing = {index for index, _ in table.differing}
    entries = []
    # Program download is a matter of the board's own bootloader.
    there = [each for each in table.objects if not od.is_program_download(each.index)]
    for _, group in groupby(there, key=lambda each: each.index):
        objects = tuple(group)
        first = objects[0]
        name = c_name(first.name if first.subindex is None else first.group)
        entries.append(_Entry(objects, name, _place(objects, differs=first.index in differing)))
    return entries


def _place(objects: Sequence[Object], *, differs: bool) -> str:
    if objects[0].index in _OF_STACK:
        return ""
    place = f"OD_{storage_group(objects)}"
    return "OD_RAM" if differs and place == _ROM else place  # skin_app_choose writes the board's own values


def _places(entries: Iterable[_Entry]) -> list[str]:
    used = {entry.place for entry in entries}
    return [place for place in _PLACES if place in used]


def _qualifier(place: str) -> str:
    return "const " if place == _ROM else f"OD_ATTR_{place[3:]} "


def _elements(entries: Iterable[_Entry], index: int) -> int:
    return next(len(entry.objects) - 1 for entry in entries if entry.index == index)


def c_name(text: str) -> str:
    """Return a name of an object as a name in C: words in camel case, hyphens as underscores, abbreviations kept."""
    words = text.replace("-", "_").replace("/", " ").split()
    name = words[0] if words[0][1:2].isupper() else words[0][:1].lower() + words[0][1:]
    for word in words[1:]:
        is_second = name[-1].isupper() and word[:2].isupper()
        name += f"_{word}" if is_second else word[:1].upper() + word[1:]
    return "".join(letter for letter in name if letter.isalnum() or letter == "_")


def _declaration(entry: _Entry) -> list[str]:
    """Return the members of a structure of values."""
    first = entry.objects[0]
    if entry.kind == "VAR":
        size = f"[{len(str(first.value))}]" if first.data_type == od.VISIBLE_STRING else ""
        return [f"    {_TYPES[first.data_type]} {entry.member}{size};"]
    if entry.kind == "ARR":
        element = _TYPES[entry.objects[1].data_type]
        return [
            f"    uint8_t {entry.member}_sub0;",
            f"    {element} {entry.member}[{len(entry.objects) - 1}];",
        ]
    members = [f"        {_TYPES[each.data_type]} {c_name(each.name)};" for each in entry.objects]
    return ["    struct {", *members, f"    }} {entry.member};"]


def _values(entry: _Entry) -> list[str]:
    """Return the initialisers of `_declaration`'s members."""
    first = entry.objects[0]
    if entry.kind == "VAR":
        return [f"    .{entry.member} = {_number(first)},"]
    if entry.kind == "ARR":
        numbers = ", ".join(_number(each) for each in entry.objects[1:])
        return [f"    .{entry.member}_sub0 = {_number(first)},", f"    .{entry.member} = {{{numbers}}},"]
    members = [f"        .{c_name(each.name)} = {_number(each)}," for each in entry.objects]
    return [f"    .{entry.member} = {{", *members, "    },"]


def _number(each: Object) -> str:
    if each.data_type == od.VISIBLE_STRING:
        return "{" + ", ".join(f"'{letter}'" for letter in str(each.value)) + "}"
    if each.data_type == od.REAL32:
        value = struct.unpack("<f", struct.pack("<f", each.value))[0]
        return f"{value!r}f" if math.isfinite(value) else "0.0f"
    return str(each.value) if int(each.value) < 10 else f"0x{int(each.value):X}"


def _object_declaration(entry: _Entry) -> str:
    kinds = {"VAR": "OD_obj_var_t", "ARR": "OD_obj_array_t", "REC": "OD_obj_record_t"}
    size = f"[{len(entry.objects)}]" if entry.kind == "REC" else ""
    return f"    {kinds[entry.kind]} {entry.member}{size};"


def _object(entry: _Entry) -> list[str]:
    """Return the description of an entry."""
    first = entry.objects[0]
    if entry.kind == "VAR":
        return [f"    .{entry.member} = {{{_pointer(entry, '')}, {_attribute(first)}, {_length(first)}}},"]
    if entry.kind == "ARR":
        element = entry.objects[1]
        fields = (
            _pointer(entry, "_sub0"),
            _pointer(entry, "[0]"),
            _attribute(first),
            _attribute(element),
            _length(element),
            f"sizeof({_TYPES[element.data_type]})",
        )
        return [f"    .{entry.member} = {{{', '.join(map(str, fields))}}},"]
    rows = [
        f"        {{{_pointer(entry, '.' + c_name(each.name))}, {each.subindex}, {_attribute(each)}, {_length(each)}}},"
        for each in entry.objects
    ]
    return [f"    .{entry.member} = {{", *rows, "    },"]


def _pointer(entry: _Entry, member: str) -> str:
    if not entry.place:
        return "NULL"
    pointer = f"&{entry.place}.{entry.member}{member}"
    return f"(void *){pointer}" if entry.place == _ROM else pointer


def _attribute(each: Object) -> str:
    flags = ["ODA_SDO_RW" if each.access == "rw" else "ODA_SDO_R"]
    if each.pdo:
        flags.append("ODA_TPDO")
    if each.data_type == od.VISIBLE_STRING:
        flags.append("ODA_STR")
    elif od.BITS[each.data_type] > 8:
        flags.append("ODA_MB")
    return " | ".join(flags)


def _length(each: Object) -> int:
    return len(str(each.value)) if each.data_type == od.VISIBLE_STRING else od.BITS[each.data_type] // 8
