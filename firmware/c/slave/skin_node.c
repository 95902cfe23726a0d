/* NMT, heartbeat, SYNC, TPDOs and emergencies of one board. */
#include "skin_node.h"

#include <string.h>

#define HEARTBEAT_BASE 0x700u
enum { NMT_START = 1, NMT_STOP = 2, NMT_PRE_OPERATIONAL = 128, NMT_RESET_NODE = 129, NMT_RESET_COMMUNICATION = 130 };
enum { SILENT, ALIVE, LOST };
/* Time from the end of a SYNC to the answer, and a time without end, nanoseconds. */
#define REACTION_NS 100000
#define NO_WINDOW_NS ((int64_t)1 << 62)
/* Transmission types of PDOs that the node sends when their content changes. */
#define ACYCLIC 0

/* Payloads, by DLC (ISO 11898-1). */
static const uint8_t fd_lengths[] = {8, 12, 16, 20, 24, 32, 48, 64};

static const uint16_t error_codes[SKIN_ERRORS] = {0x8130, 0x8240, 0xFF10};
/* Bits of the error register: communication, manufacturer, with the generic bit. */
static const uint8_t error_bits[SKIN_ERRORS] = {0x11, 0x11, 0x81};

/* Tell whether `now` is `due` or later; both may have wrapped. */
static int is_due(uint32_t now_ms, uint32_t due_ms)
{
    return now_ms - due_ms < 0x80000000u;
}

static void post(skin_node *node, const skin_frame *frame)
{
    if (node->outbox->count < node->outbox->capacity) {
        node->outbox->frames[node->outbox->count++] = *frame;
    } else {
        node->outbox->lost++;
    }
}

static skin_frame new_frame(const skin_node *node, uint32_t can_id, const uint8_t *data, uint8_t length)
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
    const skin_frame frame = new_frame(node, can_id, data, length);

    post(node, &frame);
}

static void send_state(skin_node *node)
{
    skin_send(node, HEARTBEAT_BASE + node->board->node_id, &node->state, 1);
}

/* Emergencies (CiA 301, 7.2.7): one message when an error occurs and one when it is gone. */

uint8_t skin_error_register(const skin_node *node)
{
    uint8_t bits = 0, error;

    for (error = 0; error < SKIN_ERRORS; error++) {
        bits = (uint8_t)(bits | (node->active[error] != 0 ? error_bits[error] : 0));
    }
    return bits;
}

static void announce(skin_node *node, uint16_t code, uint64_t field)
{
    uint8_t *message;

    if (node->waiting_count == SKIN_ERRORS_KEPT) { /* the oldest is lost */
        memmove(node->waiting[0], node->waiting[1], sizeof node->waiting - sizeof node->waiting[0]);
        node->waiting_count--;
    }
    message = node->waiting[node->waiting_count++];
    skin_put(message, code, 2);
    message[2] = skin_error_register(node);
    skin_put(&message[3], (uint32_t)(field & 0xFFFFFFFFu), 4);
    message[7] = (uint8_t)(field >> 32);
}

void skin_raise(skin_node *node, uint8_t error, uint64_t field)
{
    if (node->active[error] != 0) {
        return;
    }
    node->active[error] = 1;
    memmove(&node->history[1], &node->history[0], sizeof node->history - sizeof node->history[0]);
    node->history[0] = (uint32_t)(field & 0xFFFFu) << 16 | error_codes[error];
    if (node->history_count < SKIN_ERRORS_KEPT) {
        node->history_count++;
    }
    announce(node, error_codes[error], field);
}

void skin_settle(skin_node *node, uint8_t error)
{
    if (node->active[error] != 0) {
        node->active[error] = 0;
        announce(node, 0, error_codes[error]);
    }
}

static void flush_emergencies(skin_node *node, uint32_t now_ms)
{
    const uint32_t cob_id = skin_unsigned(node, SKIN_OD_EMCY_COB_ID, 0);
    const uint32_t inhibit_ms = (skin_unsigned(node, SKIN_OD_EMCY_INHIBIT, 0) + 9) / 10;

    while (node->waiting_count > 0 && is_due(now_ms, node->emcy_free_ms)) {
        if ((cob_id & SKIN_COB_ID_INVALID) == 0) {
            skin_send(node, cob_id & 0x7FFu, node->waiting[0], 8);
        }
        node->waiting_count--;
        memmove(node->waiting[0], node->waiting[1], sizeof node->waiting - sizeof node->waiting[0]);
        node->emcy_free_ms = now_ms + inhibit_ms;
    }
}

/* What the objects below 2000h say. */

static void read_tpdo(const skin_node *node, skin_tpdo *tpdo, uint8_t number)
{
    const uint16_t communication = (uint16_t)(SKIN_OD_TPDO_COMMUNICATION + number);
    const uint16_t mapping = (uint16_t)(SKIN_OD_TPDO_MAPPING + number);
    const uint32_t cob_id = skin_unsigned(node, communication, 1), count = skin_unsigned(node, mapping, 0);
    uint32_t bits = 0;
    uint8_t place;

    memset(tpdo, 0, sizeof *tpdo);
    if ((cob_id & SKIN_COB_ID_INVALID) != 0 || count == 0 || count > SKIN_PDO_BYTES) {
        return;
    }
    for (place = 0; place < count; place++) {
        const uint32_t entry = skin_unsigned(node, mapping, (uint8_t)(place + 1));
        const skin_object *object =
            skin_find(node->board, (uint16_t)(entry >> 16), (uint8_t)(entry >> 8 & 0xFFu));
        const uint8_t width = skin_mapped_bits(node, object);

        if (width == 0 || width != (entry & 0xFFu)) {
            return;
        }
        tpdo->objects[place] = (uint16_t)(object - node->board->objects);
        bits += width;
    }
    if (bits > 8u * node->board->pdo_bytes) {
        return;
    }
    tpdo->mapped = (uint8_t)count;
    tpdo->cob_id = (uint16_t)(cob_id & 0x7FFu);
    tpdo->type = (uint8_t)skin_unsigned(node, communication, 2);
    tpdo->start = (uint8_t)skin_unsigned(node, communication, 6);
    tpdo->inhibit_ms = (skin_unsigned(node, communication, 3) + 9) / 10;
    tpdo->event_ms = skin_unsigned(node, communication, 5);
    tpdo->length = (uint8_t)((bits + 7) / 8);
    for (place = 0; place < sizeof fd_lengths && tpdo->length > 8; place++) {
        if (fd_lengths[place] >= tpdo->length) {
            tpdo->length = fd_lengths[place];
            break;
        }
    }
}

static void read_watched(skin_node *node)
{
    skin_watch before[SKIN_WATCHED];
    uint8_t place, old;

    memcpy(before, node->watched, sizeof before);
    memset(node->watched, 0, sizeof node->watched);
    for (place = 0; place < SKIN_WATCHED; place++) {
        const uint32_t entry = skin_unsigned(node, SKIN_OD_WATCHED, (uint8_t)(place + 1));
        skin_watch *watch = &node->watched[place];

        if ((entry & 0xFFFFu) == 0 || entry >> 16 > SKIN_HIGHEST_NODE_ID) {
            continue;
        }
        watch->node_id = (uint8_t)(entry >> 16);
        for (old = 0; old < SKIN_WATCHED; old++) {
            if (before[old].node_id == watch->node_id) {
                *watch = before[old];
            }
        }
        watch->time_ms = (uint16_t)(entry & 0xFFFFu);
    }
}

void skin_refresh(skin_node *node, uint32_t now_ms)
{
    const uint32_t heartbeat_ms = skin_unsigned(node, SKIN_OD_HEARTBEAT, 0);
    uint8_t number;

    if (node->changed == 0) {
        return;
    }
    node->changed = 0;
    for (number = 0; number < node->board->tpdos; number++) {
        read_tpdo(node, &node->tpdos[number], number);
    }
    read_watched(node);
    if (heartbeat_ms != node->heartbeat_ms) {
        node->heartbeat_ms = heartbeat_ms;
        node->heartbeat_due_ms = now_ms + heartbeat_ms;
    }
}

/* NMT (CiA 301, 7.3.2). */

void skin_init(skin_node *node, const skin_board *board, skin_outbox *outbox)
{
    memset(node, 0, sizeof *node);
    node->board = board;
    node->outbox = outbox;
}

void skin_boot(skin_node *node, uint32_t now_ms, int communication_only)
{
    node->state = SKIN_INITIALISING;
    skin_restore(node, communication_only);
    memset(node->active, 0, sizeof node->active);
    node->history_count = node->waiting_count = 0;
    node->emcy_free_ms = now_ms;
    memset(node->watched, 0, sizeof node->watched);
    memset(node->health, 0, sizeof node->health);
    node->changed = 1;
    skin_refresh(node, now_ms);
    send_state(node);
    node->state = SKIN_PRE_OPERATIONAL;
    /* Otherwise boards that are powered together would send their heartbeats together. */
    node->heartbeat_due_ms = now_ms + node->heartbeat_ms * node->board->node_id / (SKIN_HIGHEST_NODE_ID + 1);
}

void skin_nmt(skin_node *node, const skin_frame *command, uint32_t now_ms)
{
    if (command->length != 2 || (command->data[1] != 0 && command->data[1] != node->board->node_id)) {
        return;
    }
    switch (command->data[0]) {
    case NMT_START:
        node->state = SKIN_OPERATIONAL;
        break;
    case NMT_STOP:
        node->state = SKIN_STOPPED;
        break;
    case NMT_PRE_OPERATIONAL:
        node->state = SKIN_PRE_OPERATIONAL;
        break;
    case NMT_RESET_NODE:
        skin_boot(node, now_ms, 0);
        break;
    case NMT_RESET_COMMUNICATION:
        skin_boot(node, now_ms, 1);
        break;
    default:
        break;
    }
}

/* Heartbeat consumer (CiA 301, 7.2.8.3.2): the watch on a node begins with its first heartbeat. */

static int is_any_lost(const skin_node *node)
{
    uint8_t place;

    for (place = 0; place < SKIN_WATCHED; place++) {
        if (node->watched[place].node_id != 0 && node->watched[place].state == LOST) {
            return 1;
        }
    }
    return 0;
}

void skin_heard(skin_node *node, uint8_t node_id, uint32_t now_ms)
{
    uint8_t place;

    for (place = 0; place < SKIN_WATCHED; place++) {
        skin_watch *watch = &node->watched[place];

        if (node_id != 0 && watch->node_id == node_id) {
            watch->state = ALIVE;
            watch->due_ms = now_ms + watch->time_ms;
        }
    }
    if (!is_any_lost(node)) {
        skin_settle(node, SKIN_ERROR_HEARTBEAT);
    }
}

static void watch(skin_node *node, uint32_t now_ms)
{
    /* State after a communication error, by 1029h sub 1. */
    static const uint8_t states[] = {SKIN_PRE_OPERATIONAL, SKIN_OPERATIONAL, SKIN_STOPPED};
    uint8_t place, lost = SKIN_HIGHEST_NODE_ID + 1;

    for (place = 0; place < SKIN_WATCHED; place++) {
        skin_watch *each = &node->watched[place];

        if (each->state == ALIVE && is_due(now_ms, each->due_ms + 1)) {
            each->state = LOST;
        }
        if (each->state == LOST && each->node_id < lost) {
            lost = each->node_id;
        }
    }
    if (lost <= SKIN_HIGHEST_NODE_ID && node->active[SKIN_ERROR_HEARTBEAT] == 0) {
        skin_raise(node, SKIN_ERROR_HEARTBEAT, lost);
        if (node->state == SKIN_OPERATIONAL) {
            node->state = states[skin_unsigned(node, SKIN_OD_ERROR_BEHAVIOUR, 1) % sizeof states];
        }
    } else if (lost > SKIN_HIGHEST_NODE_ID) {
        skin_settle(node, SKIN_ERROR_HEARTBEAT);
    }
}

/* TPDOs (CiA 301, 7.2.2). */

static skin_frame payload(const skin_node *node, const skin_tpdo *tpdo)
{
    skin_frame frame = new_frame(node, tpdo->cob_id, NULL, 0);
    uint16_t at = 0;
    uint8_t place, scratch[4];

    frame.length = tpdo->length;
    frame.flags = node->board->frame_flags;
    for (place = 0; place < tpdo->mapped; place++) {
        const skin_object *object = &node->board->objects[tpdo->objects[place]];
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
    post(node, frame);
    node->health[1]++;
}

/* Tell whether a cyclic PDO is due: with a SYNC start value the counter of the SYNC decides. */
static int is_turn(const skin_tpdo *tpdo, uint8_t counter)
{
    const uint8_t every = tpdo->type == ACYCLIC ? 1 : tpdo->type;

    if (tpdo->start > 0 && counter > 0) {
        const int turn = (counter - tpdo->start) % (int)SKIN_LAST_SYNCHRONOUS;

        return (turn < 0 ? turn + (int)SKIN_LAST_SYNCHRONOUS : turn) % every == 0;
    }
    return tpdo->syncs % every == 0;
}

#if SKIN_SAMPLES > 1

/* Sums of one block of averages; `newest` holds the newest sample, or the test pattern. */
static void sum_averages(skin_node *node, uint8_t block, const float *averages, const uint16_t *newest)
{
    const skin_board *board = node->board;
    const uint16_t first = (uint16_t)(block * board->block_size);
    float values[SKIN_BLOCK_SIZE];
    uint16_t place;

    for (place = 0; place < board->block_size; place++) {
        values[place] = node->pattern[block] != SKIN_PATTERN_OFF
                            ? (float)newest[place]
                            : skin_correct_average(averages[place], node->gain[first + place],
                                                   node->offset[first + place], board->count_max);
    }
    skin_average_sums(board, block, values, &node->sums[board->first_sum[block]]);
}

#endif

void skin_sample(skin_node *node, uint16_t *counts, uint16_t samples)
{
    const skin_board *board = node->board;
    const uint16_t taxels = (uint16_t)(board->blocks * board->block_size);
    uint16_t *newest = &counts[(uint32_t)(samples - 1) * taxels];
    uint8_t block;

    node->health[3] = 0;
    for (block = 0; block < board->blocks; block++) {
        const uint16_t first = (uint16_t)(block * board->block_size);
#if SKIN_SAMPLES > 1
        float averages[SKIN_BLOCK_SIZE];

        skin_take_samples(&node->averages[block], &counts[first], samples, taxels, averages);
#else
        int32_t work[SKIN_BLOCK_SIZE];
#endif
        node->health[3] += skin_read_block(board, &newest[first], &node->gain[first], &node->offset[first],
                                           node->pattern[block]);
#if SKIN_SAMPLES > 1
        sum_averages(node, block, averages, &newest[first]);
#else
        skin_block_sums(board, block, &newest[first], work, &node->sums[board->first_sum[block]]);
#endif
    }
}

void skin_sync(skin_node *node, const skin_frame *sync)
{
    const uint8_t counter = sync->length == 1 ? sync->data[0] : 0;
    const uint32_t window_us = skin_unsigned(node, SKIN_OD_WINDOW, 0);
    const uint8_t expected = skin_unsigned(node, SKIN_OD_SYNC_OVERFLOW, 0) > 0 ? 1 : 0;
    int64_t latest_ns = NO_WINDOW_NS;
    uint8_t number;

    if (node->state != SKIN_OPERATIONAL || (sync->length == 1 && (counter == 0 || counter > SKIN_LAST_SYNCHRONOUS))) {
        return;
    }
    node->health[0]++;
    if (sync->length == expected) {
        skin_settle(node, SKIN_ERROR_SYNC_LENGTH);
    } else {
        skin_raise(node, SKIN_ERROR_SYNC_LENGTH, sync->length);
    }
    if (window_us > 0) { /* so that the frame ends inside the window */
        latest_ns = (int64_t)window_us * 1000 - node->board->frame_ns;
        latest_ns = latest_ns < 1 ? 1 : latest_ns;
    }
    for (number = 0; number < node->board->tpdos; number++) {
        skin_tpdo *tpdo = &node->tpdos[number];
        skin_frame frame;

        if (tpdo->length == 0) {
            continue;
        }
        tpdo->syncs++;
        if (tpdo->type > SKIN_LAST_SYNCHRONOUS || !is_turn(tpdo, counter)) {
            continue;
        }
        frame = payload(node, tpdo);
        if (tpdo->type == ACYCLIC && is_same(tpdo, &frame)) {
            continue;
        }
        frame.time_ns = sync->time_ns + REACTION_NS;
        frame.expires_ns = sync->time_ns + latest_ns;
        send_tpdo(node, tpdo, &frame);
    }
}

static void send_events(skin_node *node, uint32_t now_ms)
{
    uint8_t number;

    for (number = 0; number < node->board->tpdos; number++) {
        skin_tpdo *tpdo = &node->tpdos[number];
        skin_frame frame;

        if (tpdo->length == 0 || tpdo->type < SKIN_EVENT_DRIVEN ||
            (tpdo->has_last != 0 && !is_due(now_ms, tpdo->sent_at_ms + tpdo->inhibit_ms))) {
            continue;
        }
        frame = payload(node, tpdo);
        if (is_same(tpdo, &frame) && (tpdo->event_ms == 0 || !is_due(now_ms, tpdo->sent_at_ms + tpdo->event_ms))) {
            continue;
        }
        tpdo->sent_at_ms = now_ms;
        send_tpdo(node, tpdo, &frame);
    }
}

void skin_given_up(skin_node *node, const skin_frame *frame)
{
    uint8_t number;

    for (number = 0; number < node->board->tpdos; number++) {
        if (node->tpdos[number].length > 0 && node->tpdos[number].cob_id == frame->can_id) {
            node->health[2]++;
            skin_raise(node, SKIN_ERROR_WINDOW, node->health[2]);
            return;
        }
    }
}

void skin_tick(skin_node *node, uint32_t now_ms)
{
    if (node->heartbeat_ms > 0 && is_due(now_ms, node->heartbeat_due_ms)) {
        send_state(node);
        node->heartbeat_due_ms = now_ms + node->heartbeat_ms;
    }
    watch(node, now_ms);
    if (node->state == SKIN_STOPPED) {
        return;
    }
    flush_emergencies(node, now_ms);
    if (node->state == SKIN_OPERATIONAL) {
        send_events(node, now_ms);
    }
}
