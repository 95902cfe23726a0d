/* One board: what a frame or a time makes of its parts. NMT and heartbeat. */
#include "skin_node.h"

#include <string.h>

enum { SILENT, ALIVE, LOST };
static void send_state(skin_node *node)
{
    skin_send(node, SKIN_HEARTBEAT_BASE + node->board->node_id, &node->state, 1);
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

static void refresh(skin_node *node, uint32_t now_ms)
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
    refresh(node, now_ms);
    send_state(node);
    node->state = SKIN_PRE_OPERATIONAL;
    /* Otherwise boards that are powered together would send their heartbeats together. */
    node->heartbeat_due_ms = now_ms + node->heartbeat_ms * node->board->node_id / (SKIN_HIGHEST_NODE_ID + 1);
}

void skin_program_init(skin_node *node, const skin_flash *flash, uint8_t slot)
{
    skin_program_open(&node->program, flash, slot);
    node->program.vendor_id = skin_unsigned(node, SKIN_OD_IDENTITY, 1);
    node->program.product_code = skin_unsigned(node, SKIN_OD_IDENTITY, 2);
}

/* Boot with the newest node-ID; without one, be silent. */
static void initialise(skin_node *node, uint32_t now_ms, int communication_only)
{
    const skin_board *board = skin_lss_image(node, node->lss.wanted);

    if (board == NULL) { /* also a node-ID that another program has stored */
        node->lss.wanted = SKIN_NO_NODE_ID;
        node->state = SKIN_INITIALISING; /* silent */
    } else {
        if (board != node->board) {
            skin_become(node, board);
            communication_only = 0;
        }
        skin_boot(node, now_ms, communication_only);
    }
    node->lss.node_id = node->lss.wanted;
}

void skin_lss_reset(skin_node *node, uint32_t now_ms, int communication_only)
{
    if (!communication_only) {
        skin_lss_load(node);
    }
    initialise(node, now_ms, communication_only);
}

void skin_lss_boot(skin_node *node, uint32_t now_ms)
{
    node->lss.lasting = SKIN_NO_NODE_ID;
    skin_lss_reset(node, now_ms, 0);
}

void skin_lss_request(skin_node *node, const skin_frame *request, uint32_t now_ms)
{
    if (skin_lss_answer(node, request)) {
        initialise(node, now_ms, 0);
    }
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

void skin_request(skin_node *node, const skin_frame *request, uint32_t now_ms)
{
    if (node->state == SKIN_PRE_OPERATIONAL || node->state == SKIN_OPERATIONAL) {
        skin_program_keep(&node->program); /* the program has been reached over the bus */
        skin_serve(node, request, now_ms);
        refresh(node, now_ms);
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
    skin_flush_emergencies(node, now_ms);
#if !SKIN_STEPPED /* stepped boards send in their slots */
    if (node->state == SKIN_OPERATIONAL) {
        skin_send_events(node, now_ms);
    }
#endif
}
