"""From the dictionary as data to the ``canopen`` library's object dictionary and local node."""

from typing import cast

import canopen
from canopen.objectdictionary import ODArray, ODRecord, ODVariable

from dbc.dictionary import OD_ROWS, OD_SUMS, Object

#: Objects whose entries are all alike.
ARRAYS = frozenset({OD_ROWS, OD_SUMS})


def object_dictionary(objects: list[Object]) -> canopen.ObjectDictionary:
    """Build the library's object dictionary."""
    dictionary = canopen.ObjectDictionary()
    for each in objects:
        variable = ODVariable(each.name, each.index, each.subindex or 0)
        variable.data_type = each.data_type
        variable.access_type = each.access
        # The library's annotation knows integers only; strings and floats work.
        variable.default = cast("int", each.value)
        variable.pdo_mappable = each.pdo
        if each.subindex is None:
            dictionary.add_object(variable)
            continue
        if each.index not in dictionary:
            kind = ODArray if each.index in ARRAYS else ODRecord
            dictionary.add_object(kind(f"Object {each.index:04X}h", each.index))
        group = dictionary[each.index]
        if isinstance(group, ODArray | ODRecord):
            group.add_member(variable)
    return dictionary


class LocalNode(canopen.LocalNode):
    """The library's local node for its dictionary and SDO server only; NMT and heartbeat are `nodes.node`'s."""

    def __init__(self, node_id: int, dictionary: canopen.ObjectDictionary) -> None:
        super().__init__(node_id, dictionary)
        # The library would start a thread per node for the heartbeat.
        self._write_callbacks.remove(self.nmt.on_write)
