/* A node that sends steps: TPDOs and objects (docs/steps.md). */
#include "skin_node.h"

#if SKIN_STEPPED

#include <string.h>

void skin_read_tpdo(skin_node *node, uint8_t number)
{
    const uint32_t cob_id = skin_unsigned(node, (uint16_t)(SKIN_OD_TPDO_COMMUNICATION + number), 1);

    node->steps.ways[number].cob_id = (uint16_t)((cob_id & SKIN_COB_ID_INVALID) != 0 ? 0 : cob_id & SKIN_BASE_ID_MASK);
}

void skin_sync(skin_node *node, const skin_frame *sync)
{
    const int counter = skin_take_sync(node, sync);

    if (counter >= 0) {
        skin_steps_sync(&node->steps, (uint8_t)counter, sync->time_ns);
    }
}

int skin_sample(skin_node *node, uint16_t *counts)
{
    if (node->steps.filter.taken == 0) { /* power-up: gains and offsets as they were stored */
        skin_restore(node, 0);
    }
    node->health[3] = skin_read_block(node->board, counts, node->gain[0], node->offset[0], node->pattern[0]);
    memcpy(node->counts, counts, sizeof node->counts);
    return skin_steps_take(&node->steps, counts, node->pattern[0]);
}

void skin_send_sums(skin_node *node, int64_t now_ns)
{
    const uint8_t chosen = skin_steps_choose(&node->steps, now_ns);
    uint8_t number;

    for (number = 0; number < node->board->type->tpdos; number++) {
        skin_frame frame = skin_new_frame(node, node->steps.ways[number].cob_id, NULL, 0);

        if ((chosen >> number & 1u) != 0) {
            frame.time_ns = now_ns;
            frame.flags = node->board->type->frame_flags;
            frame.length = skin_steps_payload(&node->steps, number, frame.data);
            skin_post(node, &frame);
        }
    }
}

/* Take note of what became of a frame; tell whether it is one of the node's words. */
static int note(skin_node *node, const skin_frame *frame, int was_sent)
{
    uint8_t number;

    for (number = 0; number < node->board->type->tpdos; number++) {
        if (frame->can_id != 0 && node->steps.ways[number].cob_id == frame->can_id) {
            skin_steps_done(&node->steps, number, was_sent);
            return 1;
        }
    }
    return 0;
}

void skin_sent(skin_node *node, const skin_frame *frame)
{
    node->health[1] += (uint32_t)note(node, frame, 1);
}

void skin_given_up(skin_node *node, const skin_frame *frame)
{
    (void)note(node, frame, 0);
}

void skin_refused(skin_node *node, const skin_frame *frame)
{
    node->health[2] += (uint32_t)note(node, frame, 0);
}

#endif
