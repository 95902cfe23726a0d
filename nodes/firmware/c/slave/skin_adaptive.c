/* A node that sends sums when they carry news: TPDOs and objects (docs/adaptive.md). */
#include "skin_node.h"

#if SKIN_ADAPTIVE

#include <string.h>

/* TPDOs. */

void skin_read_tpdo(skin_node *node, uint8_t number)
{
    const uint16_t communication = (uint16_t)(SKIN_OD_TPDO_COMMUNICATION + number);

    skin_sender_configure(&node->sender, number, skin_unsigned(node, communication, 1),
                          skin_unsigned(node, communication, 3));
}

void skin_answer(skin_node *node, const skin_frame *sync, uint8_t counter)
{
    (void)counter;
    node->sender.sync_ns = sync->time_ns;
}

void skin_send_events(skin_node *node, uint32_t now_ms)
{
    (void)node; /* sums are sent after each sample */
    (void)now_ms;
}

void skin_forget_sent(skin_node *node)
{
    skin_sender_forget(&node->sender);
}

void skin_note_state(skin_node *node)
{
    skin_sender_operate(&node->sender, node->state == SKIN_OPERATIONAL);
}

int skin_sample(skin_node *node, uint16_t *counts)
{
    if (node->sender.filter.taken == 0) { /* power-up: gains and offsets as they were stored */
        skin_restore(node, 0);
    }
    node->health[3] = skin_read_block(node->board, counts, node->gain, node->offset, node->pattern[0]);
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
    frame.flags = node->board->frame_flags;
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

/* Number of the TPDO of a frame of ours that a controller may hold, or -1. */
static int tpdo_of(const skin_node *node, const skin_frame *frame)
{
    return skin_sender_tpdo_of(&node->sender, frame->can_id, frame->length);
}

void skin_sent(skin_node *node, const skin_frame *frame)
{
    const int number = tpdo_of(node, frame);

    if (number >= 0) {
        node->health[1]++;
        skin_sender_sent(&node->sender, (uint8_t)number, frame->data);
    }
}

void skin_given_up(skin_node *node, const skin_frame *frame)
{
    const int number = tpdo_of(node, frame);

    if (number >= 0) {
        skin_sender_give_back(&node->sender, (uint8_t)number);
    }
}

void skin_refused(skin_node *node, const skin_frame *frame)
{
    skin_given_up(node, frame);
    if (tpdo_of(node, frame) >= 0) {
        node->health[2]++;
    }
}

/* Objects. */

uint32_t skin_check_adaptive(uint16_t index, uint8_t subindex, uint32_t value)
{
    return skin_sender_allows(index, subindex, value) ? 0 : SKIN_ABORT_VALUE;
}

void skin_adjust_adaptive(skin_node *node, const skin_object *object, uint32_t value)
{
    const uint8_t place = (uint8_t)(object->subindex - 1);

    switch (object->index) {
    case SKIN_OD_REFRESH:
        skin_sender_ask(&node->sender, (uint8_t)value);
        break;
    case SKIN_OD_SENDING:
        skin_sender_set_rule(&node->sender, place, value);
        break;
    case SKIN_OD_COEFFICIENT_NOISE:
    case SKIN_OD_TAXEL_NOISE:
        skin_sender_set_noise(&node->sender, object->index, place, value);
        break;
    case SKIN_OD_BUDGET:
        skin_sender_set_budget(&node->sender, value);
        break;
    default:
        break;
    }
}

void skin_restore_adaptive(skin_node *node)
{
    skin_filter *filter = &node->sender.filter;

    memset(filter->given_taxel_n, 0, sizeof filter->given_taxel_n);
    memset(filter->given_coefficient_n, 0, sizeof filter->given_coefficient_n);
    skin_filter_give(filter);
}

int32_t skin_adaptive_sum(const skin_node *node, uint8_t number)
{
    return skin_sender_sum(&node->sender, number);
}

static const uint8_t *put_real(uint8_t *scratch, float value)
{
    uint32_t bits;

    memcpy(&bits, &value, sizeof bits);
    skin_put(scratch, bits, sizeof bits);
    return scratch;
}

const uint8_t *skin_adaptive_value(const skin_node *node, const skin_object *object, uint8_t *scratch)
{
    const skin_sender *sender = &node->sender;
    const uint8_t place = (uint8_t)(object->subindex - 1);
    uint8_t coarse[SKIN_BLOCK_SUMS], fine[SKIN_BLOCK_SUMS];

    if (object->index == SKIN_OD_REFRESH) {
        scratch[0] = skin_sender_wanted(sender);
        return scratch;
    }
    if (object->index == SKIN_OD_NODE_NOISE) {
        return put_real(scratch, (float)sender->filter.noise_n);
    }
    if (object->subindex == 0) {
        return NULL;
    }
    switch (object->index) {
    case SKIN_OD_COEFFICIENT_NOISE:
        return put_real(scratch, sender->filter.coefficient_n[place]);
    case SKIN_OD_TAXEL_NOISE:
        return put_real(scratch, sender->filter.taxel_n[place]);
    case SKIN_OD_COARSE:
    case SKIN_OD_FINE:
        skin_present_codes(&sender->groups, sender->filter.sums_n, coarse, fine);
        if (object->index == SKIN_OD_COARSE) {
            scratch[0] = coarse[place];
        } else {
            memcpy(scratch, &fine[SKIN_GROUP_SUMS * place], SKIN_GROUP_SUMS);
        }
        return scratch;
    default:
        return NULL;
    }
}

#endif
