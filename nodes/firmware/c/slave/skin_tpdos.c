/* TPDOs of a board that sends its sums at every SYNC. */
#include "skin_node.h"

#include <string.h>

#if !SKIN_STEPPED

/* A time without end, nanoseconds. */
#define NO_WINDOW_NS ((int64_t)1 << 62)
/* Transmission types of PDOs that the node sends when their content changes. */
#define ACYCLIC 0

/* Payloads, by DLC (ISO 11898-1). */
static const uint8_t fd_lengths[] = SKIN_FD_LENGTHS;

void skin_read_tpdo(skin_node *node, uint8_t number)
{
    skin_tpdo *tpdo = &node->tpdos[number];
    const uint16_t communication = (uint16_t)(SKIN_OD_TPDO_COMMUNICATION + number);
    const uint16_t mapping = (uint16_t)(SKIN_OD_TPDO_MAPPING + number);
    const uint32_t cob_id = skin_unsigned(node, communication, 1), count = skin_unsigned(node, mapping, 0);
    uint32_t bits = 0;
    uint8_t place;

    memset(tpdo, 0, sizeof *tpdo);
    if ((cob_id & SKIN_COB_ID_INVALID) != 0 || count == 0 || count > SKIN_MAPPED) {
        return;
    }
    for (place = 0; place < count; place++) {
        const uint32_t entry = skin_unsigned(node, mapping, (uint8_t)(place + 1));
        const skin_object *object = skin_mapped(node, entry);

        if (object == NULL) {
            return;
        }
        tpdo->objects[place] = (uint16_t)(object - node->board->type->objects);
        bits += entry & 0xFFu;
    }
    if (bits > 8u * node->board->type->pdo_bytes) {
        return;
    }
    tpdo->mapped = (uint8_t)count;
    tpdo->cob_id = (uint16_t)(cob_id & SKIN_BASE_ID_MASK);
    tpdo->type = (uint8_t)skin_unsigned(node, communication, 2);
    tpdo->start = (uint8_t)skin_unsigned(node, communication, 6);
    tpdo->inhibit_ms = (skin_unsigned(node, communication, 3) + 9) / 10;
    tpdo->event_ms = skin_unsigned(node, communication, 5);
    tpdo->length = (uint8_t)((bits + 7) / 8);
    for (place = 0; fd_lengths[place] < tpdo->length; place++) {
    }
    tpdo->length = fd_lengths[place];
}

static skin_frame payload(const skin_node *node, const skin_tpdo *tpdo)
{
    skin_frame frame = skin_new_frame(node, tpdo->cob_id, NULL, 0);
    uint16_t at = 0;
    uint8_t place, scratch[SKIN_NUMBER_BYTES];

    frame.length = tpdo->length;
    frame.flags = node->board->type->frame_flags;
    for (place = 0; place < tpdo->mapped; place++) {
        const skin_object *object = &node->board->type->objects[tpdo->objects[place]];
        const uint8_t bits = skin_mapped_bits(node, object);

        skin_put_bits(frame.data, at, skin_get(skin_value(node, object, scratch), object->bytes), bits);
        at = (uint16_t)(at + bits);
    }
    return frame;
}

static int is_same(const skin_tpdo *tpdo, const skin_frame *frame)
{
    return tpdo->has_last != 0 && memcmp(tpdo->last, frame->data, tpdo->length) == 0;
}

static void send_tpdo(skin_node *node, skin_tpdo *tpdo, const skin_frame *frame)
{
    memcpy(tpdo->last, frame->data, tpdo->length);
    tpdo->has_last = 1;
    skin_post(node, frame);
    node->health[1]++;
}

/* Tell whether a cyclic PDO is due: with a SYNC start value the counter of the SYNC decides. */
static int is_due(const skin_tpdo *tpdo, uint8_t counter)
{
    const uint8_t every = tpdo->type == ACYCLIC ? 1 : tpdo->type;

    return tpdo->start > 0 && counter > 0 ? skin_is_turn(every, tpdo->start, counter) : tpdo->syncs % every == 0;
}

/* Make the sums of a SYNC. */
static void measure(skin_node *node, skin_reading *readings, uint16_t samples, uint8_t counter)
{
    const skin_board *board = node->board;
    uint8_t number;

    node->sync_counter = counter;
    node->health[3] = 0;
    for (number = 0; number < board->type->blocks; number++) {
        const skin_block block = {node->gain[number], node->offset[number], node->counts[number], &node->pattern[number]};

        node->health[3] += skin_measure(board, number, SKIN_AVERAGE_OF(node->averages, number), readings, samples, &block,
                                        &node->sums[board->type->first_sum[number]]);
    }
}

void skin_sync(skin_node *node, const skin_frame *sync, skin_reading *readings, uint16_t samples)
{
    uint32_t window_us;
    int64_t latest_ns = NO_WINDOW_NS;
    const int counter = skin_take_sync(node, sync);
    uint8_t number;

    if (counter < 0) {
        return;
    }
    measure(node, readings, samples, (uint8_t)counter);
    if (node->state != SKIN_OPERATIONAL) {
        return;
    }
    window_us = skin_unsigned(node, SKIN_OD_WINDOW_US, 0);
    if (window_us > 0) { /* so that the frame ends inside the window */
        latest_ns = (int64_t)window_us * 1000 - node->board->type->frame_ns;
        latest_ns = latest_ns < 1 ? 1 : latest_ns;
    }
    for (number = 0; number < node->board->type->tpdos; number++) {
        skin_tpdo *tpdo = &node->tpdos[number];
        skin_frame frame;

        if (tpdo->length == 0) {
            continue;
        }
        tpdo->syncs++;
        if (tpdo->type > SKIN_LAST_SYNCHRONOUS || !is_due(tpdo, (uint8_t)counter)) {
            continue;
        }
        frame = payload(node, tpdo);
        if (tpdo->type == ACYCLIC && is_same(tpdo, &frame)) {
            continue;
        }
        frame.time_ns = sync->time_ns + SKIN_REACTION_NS;
        frame.expires_ns = sync->time_ns + latest_ns;
        send_tpdo(node, tpdo, &frame);
    }
}

void skin_send_events(skin_node *node, uint32_t now_ms)
{
    uint8_t number;

    for (number = 0; number < node->board->type->tpdos; number++) {
        skin_tpdo *tpdo = &node->tpdos[number];
        skin_frame frame;

        if (tpdo->length == 0 || tpdo->type < SKIN_EVENT_MANUFACTURER ||
            (tpdo->has_last != 0 && !skin_is_due(now_ms, tpdo->sent_at_ms + tpdo->inhibit_ms))) {
            continue;
        }
        frame = payload(node, tpdo);
        if (is_same(tpdo, &frame) && (tpdo->event_ms == 0 || !skin_is_due(now_ms, tpdo->sent_at_ms + tpdo->event_ms))) {
            continue;
        }
        tpdo->sent_at_ms = now_ms;
        send_tpdo(node, tpdo, &frame);
    }
}

static int is_tpdo(const skin_node *node, const skin_frame *frame)
{
    uint8_t number;

    for (number = 0; number < node->board->type->tpdos; number++) {
        if (node->tpdos[number].length > 0 && node->tpdos[number].cob_id == frame->can_id) {
            return 1;
        }
    }
    return 0;
}

void skin_given_up(skin_node *node, const skin_frame *frame)
{
    if (is_tpdo(node, frame)) {
        node->health[2]++;
        node->missed_at = node->health[0];
        skin_raise(node, SKIN_ERROR_WINDOW, node->health[2]);
    }
}

void skin_refused(skin_node *node, const skin_frame *frame)
{
    if (is_tpdo(node, frame)) {
        node->health[1]--;
        node->health[2]++;
    }
}

#endif
