/* NMT, heartbeat, SYNC and emergencies of one board. */
#include "skin_node.h"

#include <string.h>

enum { SILENT, ALIVE, LOST };
static const uint16_t error_codes[SKIN_ERRORS] = {SKIN_EMERGENCY_HEARTBEAT_LOST, SKIN_EMERGENCY_SYNC_LENGTH,
                                                  SKIN_EMERGENCY_WINDOW_MISSED};
/* Bits of the error register. */
static const uint8_t error_bits[SKIN_ERRORS] = {SKIN_REGISTER_GENERIC | SKIN_REGISTER_COMMUNICATION,
                                                SKIN_REGISTER_GENERIC | SKIN_REGISTER_COMMUNICATION,
                                                SKIN_REGISTER_GENERIC | SKIN_REGISTER_MANUFACTURER};

int skin_is_due(uint32_t now_ms, uint32_t due_ms)
{
    return now_ms - due_ms < 0x80000000u;
}

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

static void send_state(skin_node *node)
{
    skin_send(node, SKIN_HEARTBEAT_BASE + node->board->node_id, &node->state, 1);
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
    const uint32_t inhibit_ms = (skin_unsigned(node, SKIN_OD_EMCY_INHIBIT_100US, 0) + 9) / 10;

    while (node->waiting_count > 0 && skin_is_due(now_ms, node->emcy_free_ms)) {
        if ((cob_id & SKIN_COB_ID_INVALID) == 0) {
            skin_send(node, cob_id & SKIN_BASE_ID_MASK, node->waiting[0], 8);
        }
        node->waiting_count--;
        memmove(node->waiting[0], node->waiting[1], sizeof node->waiting - sizeof node->waiting[0]);
        node->emcy_free_ms = now_ms + inhibit_ms;
    }
}

/* What the objects below 2000h say. */

static void read_watched(skin_node *node)
{
    skin_watch before[SKIN_WATCHED];
    uint8_t place, old;

    memcpy(before, node->watched, sizeof before);
    memset(node->watched, 0, sizeof node->watched);
    for (place = 0; place < SKIN_WATCHED; place++) {
        const uint32_t entry = skin_unsigned(node, SKIN_OD_CONSUMER_HEARTBEAT, (uint8_t)(place + 1));
        skin_watch *watch = &node->watched[place];

        watch->node_id = skin_watched_node(entry);
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
    const uint32_t heartbeat_ms = skin_unsigned(node, SKIN_OD_HEARTBEAT_MS, 0);
    uint8_t number;

    if (node->changed == 0) {
        return;
    }
    node->changed = 0;
    for (number = 0; number < node->board->type->tpdos; number++) {
        skin_read_tpdo(node, number);
    }
    read_watched(node);
    if (heartbeat_ms != node->heartbeat_ms) {
        node->heartbeat_ms = heartbeat_ms;
        node->heartbeat_due_ms = now_ms + heartbeat_ms;
    }
}

/* NMT (CiA 301, 7.3.2). */

void skin_init(skin_node *node, const skin_board *board, skin_outbox *outbox, const skin_storage *storage)
{
    memset(node, 0, sizeof *node);
    node->outbox = outbox;
    node->storage = storage;
    node->lss.node_id = node->lss.wanted = node->lss.lasting = board->node_id;
    node->lss.bit_timings = SKIN_BIT_TIMINGS;
    skin_become(node, board);
}

void skin_boot(skin_node *node, uint32_t now_ms, int communication_only)
{
    node->state = SKIN_INITIALISING;
    skin_restore(node, communication_only);
    memset(&node->sdo, 0, sizeof node->sdo);
    memset(node->active, 0, sizeof node->active);
    node->history_count = node->waiting_count = 0;
    node->emcy_free_ms = now_ms;
    memset(node->watched, 0, sizeof node->watched);
    memset(node->health, 0, sizeof node->health);
#if SKIN_STEPPED
    skin_steps_forget(&node->steps);
#endif
    node->changed = 1;
    skin_refresh(node, now_ms);
    send_state(node);
    node->state = SKIN_PRE_OPERATIONAL;
    /* Otherwise boards that are powered together would send their heartbeats together. */
    node->heartbeat_due_ms = now_ms + node->heartbeat_ms * node->board->node_id / (SKIN_HIGHEST_NODE_ID + 1);
}

static void note_state(skin_node *node)
{
#if SKIN_STEPPED
    skin_steps_operate(&node->steps, node->state == SKIN_OPERATIONAL);
#else
    (void)node; /* nothing begins with OPERATIONAL */
#endif
}

void skin_nmt(skin_node *node, const skin_frame *command, uint32_t now_ms)
{
    if (command->length != SKIN_NMT_BYTES || (command->data[1] != 0 && command->data[1] != node->board->node_id) ||
        node->state == SKIN_INITIALISING) {
        return;
    }
    switch (command->data[0]) {
    case SKIN_NMT_START:
        node->state = SKIN_OPERATIONAL;
        break;
    case SKIN_NMT_STOP:
        node->state = SKIN_STOPPED;
        break;
    case SKIN_NMT_ENTER_PRE_OPERATIONAL:
        node->state = SKIN_PRE_OPERATIONAL;
        break;
    case SKIN_NMT_RESET_NODE:
    case SKIN_NMT_RESET_COMMUNICATION:
        skin_lss_reset(node, now_ms, command->data[0] == SKIN_NMT_RESET_COMMUNICATION);
        break;
    default:
        break;
    }
    note_state(node);
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

        if (each->state == ALIVE && skin_is_due(now_ms, each->due_ms + 1)) {
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

int skin_take_sync(skin_node *node, const skin_frame *sync)
{
    const uint8_t counter = sync->length == 1 ? sync->data[0] : 0;
    const uint8_t expected = skin_unsigned(node, SKIN_OD_SYNC_OVERFLOW, 0) > 0 ? 1 : 0;

    if (sync->length == 1 && (counter == 0 || counter > SKIN_LAST_SYNCHRONOUS)) {
        return -1;
    }
    if (node->state == SKIN_OPERATIONAL) {
        node->health[0]++;
        if (sync->length == expected) {
            skin_settle(node, SKIN_ERROR_SYNC_LENGTH);
        } else {
            skin_raise(node, SKIN_ERROR_SYNC_LENGTH, sync->length);
        }
    }
    return counter;
}

void skin_tick(skin_node *node, uint32_t now_ms)
{
    if (node->state == SKIN_INITIALISING) {
        return;
    }
    if (node->heartbeat_ms > 0 && skin_is_due(now_ms, node->heartbeat_due_ms)) {
        send_state(node);
        node->heartbeat_due_ms = now_ms + node->heartbeat_ms;
    }
    watch(node, now_ms);
    note_state(node);
    if (node->state == SKIN_STOPPED) {
        return;
    }
    skin_sdo_tick(node, now_ms);
    flush_emergencies(node, now_ms);
#if !SKIN_STEPPED /* stepped boards send in their slots */
    if (node->state == SKIN_OPERATIONAL) {
        skin_send_events(node, now_ms);
    }
#endif
}
