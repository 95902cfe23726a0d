#include "skin_boards.h"

#include <string.h>

/* The records of the caller are 88 bytes long. */
typedef char frame_has_its_size[sizeof(skin_frame) == 88 ? 1 : -1];

static skin_outbox new_outbox(skin_frame *out, size_t capacity)
{
    skin_outbox outbox;

    outbox.frames = out;
    outbox.capacity = capacity;
    outbox.count = 0;
    return outbox;
}

/* What the converters of a board, and then of those behind it, read. */
typedef struct {
    const skin_reading *values; /* NULL: nothing, and no SYNC is answered */
    uint16_t samples;
    uint32_t stride;
} reading;

/* Pass a SYNC to a board. */
static void pass_sync(skin_node *node, const skin_frame *sync, const reading *read)
{
#if SKIN_STEPPED
    (void)read; /* samples by its own clock */
    skin_sync(node, sync);
#else
    skin_reading own[SKIN_MOST_SAMPLES * SKIN_READINGS];
    const uint16_t count = skin_readings(node->board);
    uint16_t each;

    if (read->values == NULL) {
        return;
    }
    for (each = 0; each < read->samples; each++) {
        memcpy(&own[(uint32_t)each * count], &read->values[each * read->stride], count * sizeof own[0]);
    }
    skin_sync(node, sync, own, read->samples);
#endif
}

#if SKIN_STEPPED

/* Pass what became of the boards' own TPDOs. */
static void pass_own(skin_node *node, const skin_frame *frame)
{
    const uint8_t outcome = frame->flags & SKIN_FRAME_DISCARDED;

    if ((frame->flags & (SKIN_FRAME_EXTENDED | SKIN_FRAME_REMOTE)) != 0) {
        return;
    }
    if (outcome == SKIN_FRAME_DISCARDED) {
        skin_given_up(node, frame);
    } else if (outcome == SKIN_FRAME_ECHO) {
        skin_sent(node, frame);
    }
}

#endif

/* Pass one frame to one board. */
static void pass(skin_node *node, const skin_frame *frame, uint32_t now_ms, const reading *read)
{
    const uint32_t can_id = frame->can_id;
    const int is_echo = (frame->flags & SKIN_FRAME_ECHO) != 0;

    if ((frame->flags & SKIN_FRAME_DISCARDED) == SKIN_FRAME_DISCARDED) {
#if !SKIN_STEPPED
        if (frame->port == node->board->node_id) {
            skin_given_up(node, frame);
        }
#endif
        return;
    }
    if ((frame->flags & (SKIN_FRAME_ERROR | SKIN_FRAME_EXTENDED | SKIN_FRAME_REMOTE)) != 0) {
        return;
    }
    /* The boards of one process receive each other's heartbeats as echoes. */
    if (SKIN_HEARTBEAT_BASE < can_id && can_id <= SKIN_HEARTBEAT_BASE + SKIN_HIGHEST_NODE_ID) {
        skin_heard(node, (uint8_t)(can_id - SKIN_HEARTBEAT_BASE), now_ms);
    } else if (is_echo) {
        return;
    } else if (can_id == SKIN_SYNC_COB_ID) {
        pass_sync(node, frame, read);
    } else if (can_id == SKIN_NMT_COB_ID) {
        skin_nmt(node, frame, now_ms);
    } else if (can_id == SKIN_LSS_REQUEST_COB_ID) {
        skin_lss_request(node, frame, now_ms);
    } else if (can_id == SKIN_SDO_REQUEST_BASE + node->board->node_id && frame->length == SKIN_SDO_BYTES) {
        skin_request(node, frame, now_ms);
        if (node->program.is_resetting) {
            skin_program_init(node, node->program.flash, skin_program_choose(node->program.flash));
            skin_lss_reset(node, now_ms, 0);
        }
    }
}

/* Connect a board; its serial number stays whatever node-ID LSS gives. */
static void connect(skin_node *node, uint32_t board, const skin_storage *storages, uint32_t place, skin_outbox *outbox)
{
    skin_init(node, &skin_boards[board], outbox, storages == NULL ? NULL : &storages[place]);
    node->serial_number = skin_unsigned(node, SKIN_OD_IDENTITY, 4);
}

size_t skin_power_up(skin_node *nodes, uint32_t first, uint32_t boards, const skin_storage *storages,
                     const skin_flash *flashes, int unnumbered, uint32_t now_ms, skin_frame *out, size_t capacity)
{
    skin_outbox outbox = new_outbox(out, capacity);
    uint32_t each;

    for (each = 0; each < boards; each++) {
#if SKIN_STEPPED
        nodes[each].outbox = &outbox; /* after skin_prepare and what was learned */
        (void)first;
        (void)storages;
#else
        connect(&nodes[each], first + each, storages, each, &outbox);
#endif
        skin_program_init(&nodes[each], &flashes[each], skin_program_choose(&flashes[each]));
        if (unnumbered) {
            skin_lss_boot(&nodes[each], now_ms);
        } else {
            skin_boot(&nodes[each], now_ms, 0);
        }
    }
    return outbox.count;
}

size_t skin_take(skin_node *nodes, uint32_t boards, uint32_t now_ms, const skin_reading *readings, uint16_t samples,
                 uint32_t stride, const skin_frame *frames, size_t count, skin_frame *out, size_t capacity)
{
    reading read = {readings, samples, stride};
    skin_outbox outbox = new_outbox(out, capacity);
    uint32_t each;
    size_t place;

#if SKIN_STEPPED
    for (place = 0; place < count; place++) {
        for (each = 0; (frames[place].flags & SKIN_FRAME_ECHO) != 0 && each < boards; each++) {
            pass_own(&nodes[each], &frames[place]);
        }
    }
#endif
    for (place = 0; place < count; place++) {
        read.values = readings;
        for (each = 0; each < boards; each++) {
            nodes[each].outbox = &outbox;
            pass(&nodes[each], &frames[place], now_ms, &read);
            if (readings != NULL) {
                read.values += skin_readings(nodes[each].board);
            }
        }
    }
    return outbox.count;
}

size_t skin_pass_time(skin_node *nodes, uint32_t boards, uint32_t now_ms, skin_frame *out, size_t capacity)
{
    skin_outbox outbox = new_outbox(out, capacity);
    uint32_t each;

    for (each = 0; each < boards; each++) {
        nodes[each].outbox = &outbox;
        skin_tick(&nodes[each], now_ms);
    }
    return outbox.count;
}

size_t skin_refuse(skin_node *nodes, uint32_t boards, const skin_frame *frames, size_t count)
{
    uint32_t each;
    size_t place;

    for (place = 0; place < count; place++) {
        for (each = 0; each < boards; each++) {
            if (frames[place].port == nodes[each].board->node_id) {
                skin_refused(&nodes[each], &frames[place]);
            }
        }
    }
    return count;
}

#if SKIN_STEPPED

void skin_prepare(skin_node *nodes, uint32_t first, uint32_t boards, const skin_storage *storages)
{
    uint32_t each;

    for (each = 0; each < boards; each++) {
        connect(&nodes[each], first + each, storages, each, NULL);
    }
}

size_t skin_take_counts(skin_node *nodes, uint32_t boards, uint16_t *counts)
{
    uint32_t each;
    size_t ready = 0;

    for (each = 0; each < boards; each++) {
        ready += skin_sample(&nodes[each], &counts[each * SKIN_BLOCK_SUMS]) != 0;
    }
    return ready;
}

size_t skin_choose(skin_node *nodes, uint32_t boards, int64_t now_ns, skin_frame *out, size_t capacity)
{
    skin_outbox outbox = new_outbox(out, capacity);
    uint32_t each;

    for (each = 0; each < boards; each++) {
        nodes[each].outbox = &outbox;
        skin_send_sums(&nodes[each], now_ns);
    }
    return outbox.count;
}

size_t skin_under_way(const skin_node *nodes, uint32_t boards)
{
    uint32_t each;
    uint8_t number;
    size_t held = 0;

    for (each = 0; each < boards; each++) {
        for (number = 0; number < nodes[each].board->type->tpdos; number++) {
            held += nodes[each].steps.ways[number].held_until_ns > 0;
        }
    }
    return held;
}

#endif

size_t skin_node_bytes(void)
{
    return sizeof(skin_node);
}
