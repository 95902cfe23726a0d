/* A node that sends sums when they carry news: TPDOs and objects (docs/adaptive.md). */
#include "skin_node.h"

#if SKIN_ADAPTIVE

#include <string.h>

void skin_read_tpdo(skin_node *node, uint8_t number)
{
    const uint16_t communication = (uint16_t)(SKIN_OD_TPDO_COMMUNICATION + number);

    skin_sender_configure(&node->sender, number, skin_unsigned(node, communication, 1),
                          skin_unsigned(node, communication, 3));
}

void skin_sync(skin_node *node, const skin_frame *sync)
{
    if (skin_take_sync(node, sync) >= 0) {
        node->sender.sync_ns = sync->time_ns;
    }
}

int skin_sample(skin_node *node, uint16_t *counts)
{
    if (node->sender.filter.taken == 0) { /* power-up: gains and offsets as they were stored */
        skin_restore(node, 0);
    }
    node->health[3] = skin_read_block(node->board, counts, node->gain[0], node->offset[0], node->pattern[0]);
    memcpy(node->counts, counts, sizeof node->counts);
    return skin_sender_take(&node->sender, counts);
}

void skin_decide(skin_node *node, int64_t passed_ns)
{
    skin_sender_decide(&node->sender, passed_ns);
}

uint16_t skin_due(const skin_node *node, uint8_t group)
{
    return skin_sender_due(&node->sender, group);
}

void skin_send_group(skin_node *node, uint8_t group, int64_t now_ns, int64_t expires_ns)
{
    const uint8_t number = skin_tpdo_of(&node->sender.groups, group);
    skin_frame frame = skin_new_frame(node, node->sender.tpdos[number].cob_id, NULL, 0);

    frame.time_ns = now_ns;
    frame.expires_ns = expires_ns;
    frame.flags = node->board->type->frame_flags;
    frame.length = skin_sender_make(&node->sender, group, frame.data);
    if (frame.length > 0) {
        skin_post(node, &frame);
    }
}

void skin_send_sums(skin_node *node, int64_t now_ns)
{
    const int64_t period_ns = (int64_t)skin_unsigned(node, SKIN_OD_CYCLE_PERIOD_US, 0) * 1000;
    const int64_t expires_ns = skin_sender_expiry(&node->sender, now_ns, period_ns);
    uint8_t turn;

    for (turn = 0; expires_ns != 0 && turn < SKIN_GROUPS; turn++) {
        const int group = skin_sender_most_urgent(&node->sender);

        if (group < 0) {
            return;
        }
        skin_send_group(node, (uint8_t)group, now_ns, expires_ns);
    }
}

void skin_sent(skin_node *node, const skin_frame *frame)
{
    if (skin_sender_sent(&node->sender, frame->can_id, frame->length, frame->data)) {
        node->health[1]++;
    }
}

void skin_given_up(skin_node *node, const skin_frame *frame)
{
    (void)skin_sender_give_back(&node->sender, frame->can_id, frame->length);
}

void skin_refused(skin_node *node, const skin_frame *frame)
{
    if (skin_sender_give_back(&node->sender, frame->can_id, frame->length)) {
        node->health[2]++;
    }
}

const uint8_t *skin_adaptive_value(const skin_node *node, const skin_object *object, uint8_t *scratch)
{
    const skin_sender *sender = &node->sender;
    const uint8_t place = (uint8_t)(object->subindex - 1);
    uint8_t coarse[SKIN_BLOCK_SUMS], fine[SKIN_BLOCK_SUMS];
    uint32_t value;

    if (skin_sender_read(sender, object->index, object->subindex, &value)) {
        skin_put(scratch, value, object->bytes);
        return scratch;
    }
    if (object->subindex == 0 || (object->index != SKIN_OD_COARSE && object->index != SKIN_OD_FINE)) {
        return NULL;
    }
    skin_present_codes(&sender->groups, sender->filter.sums_n, coarse, fine);
    if (object->index == SKIN_OD_COARSE) {
        scratch[0] = coarse[place];
    } else {
        memcpy(scratch, &fine[SKIN_GROUP_SUMS * place], SKIN_GROUP_SUMS);
    }
    return scratch;
}

#endif
