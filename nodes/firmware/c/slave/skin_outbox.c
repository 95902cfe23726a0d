/* The frames that a board sends. */
#include "skin_node.h"

#include <string.h>

void skin_post(skin_node *node, const skin_frame *frame)
{
    if (node->outbox->count < node->outbox->capacity) {
        node->outbox->frames[node->outbox->count++] = *frame;
    }
}

skin_frame skin_new_frame(const skin_node *node, uint32_t can_id, const uint8_t *data, uint8_t length)
{
    skin_frame frame;

    memset(&frame, 0, sizeof frame);
    frame.can_id = can_id;
    frame.length = length;
    frame.port = node->board->node_id;
    if (length > 0) {
        memcpy(frame.data, data, length);
    }
    return frame;
}

void skin_send(skin_node *node, uint32_t can_id, const uint8_t *data, uint8_t length)
{
    const skin_frame frame = skin_new_frame(node, can_id, data, length);

    skin_post(node, &frame);
}
