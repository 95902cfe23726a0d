#include "board.h"

#include <stddef.h>

const skin_board *skin_board_of(uint8_t bus, uint8_t node_id)
{
    uint16_t each;

    for (each = 0; each < SKIN_BOARDS; each++) {
        if (skin_boards[each].bus == bus && skin_boards[each].node_id == node_id) {
            return &skin_boards[each];
        }
    }
    return NULL;
}

int skin_is_own(const skin_type *type, uint16_t at)
{
    return at < type->own_first || (at >= type->own_from && at < (uint32_t)type->own_from + type->own_middle);
}

const uint8_t *skin_default(const skin_board *board, uint16_t at)
{
    const skin_type *type = board->type;
    const uint16_t shared = (uint16_t)(type->own_from - type->own_first);

    if (skin_is_own(type, at)) {
        return &board->own[at < type->own_first ? at : at - shared];
    }
    return &type->values[at - type->own_first - (at < type->own_from ? 0 : type->own_middle)];
}
