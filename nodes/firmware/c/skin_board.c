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
    return at < type->own_writable ||
           (at >= type->writable_bytes && at < (uint32_t)type->writable_bytes + type->own_constant);
}

const uint8_t *skin_default(const skin_board *board, uint16_t at)
{
    const skin_type *type = board->type;
    const uint16_t shared = (uint16_t)(type->writable_bytes - type->own_writable);

    if (skin_is_own(type, at)) {
        return &board->own[at < type->own_writable ? at : at - shared];
    }
    return &type->values[at - type->own_writable - (at < type->writable_bytes ? 0 : type->own_constant)];
}
