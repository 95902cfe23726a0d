#include "skin_boards.h"

#include <string.h>

#define REQUEST_BASE 0x600u
#define HEARTBEAT_BASE 0x700u

/* The records of the caller are 88 bytes long. */
typedef char frame_has_its_size[sizeof(skin_frame) == 88 ? 1 : -1];

static skin_outbox new_outbox(skin_frame *out, size_t capacity)
{
    skin_outbox outbox;

    outbox.frames = out;
    outbox.capacity = capacity;
    outbox.count = outbox.lost = 0;
    return outbox;
}

/* What all taxels of the skin read. */
typedef struct {
    const uint16_t *counts; /* NULL: nothing */
    uint16_t samples;
    uint32_t taxels;
} reading;

static void sample(skin_node *node, const reading *read)
{
    uint16_t chain[SKIN_MOST_SAMPLES * SKIN_BLOCKS * SKIN_BLOCK_SIZE];
    const uint16_t size = (uint16_t)(node->board->blocks * node->board->block_size);
    uint16_t place, each;

    for (each = 0; each < read->samples; each++) {
        for (place = 0; place < size; place++) {
            chain[(uint32_t)each * size + place] = read->counts[each * read->taxels + node->board->taxels[place]];
        }
    }
    skin_sample(node, chain, read->samples);
}

/* Pass one frame to one board. */
static void pass(skin_node *node, const skin_frame *frame, uint32_t now_ms, const reading *read)
{
    const uint32_t can_id = frame->can_id;
    const int is_echo = (frame->flags & SKIN_FRAME_ECHO) != 0;

    if ((frame->flags & SKIN_FRAME_DISCARDED) == SKIN_FRAME_DISCARDED) {
        if (frame->port == node->board->node_id) {
            skin_given_up(node, frame);
        }
        return;
    }
    if ((frame->flags & (SKIN_FRAME_ERROR | SKIN_FRAME_EXTENDED | SKIN_FRAME_REMOTE)) != 0) {
        return;
    }
    /* The boards of one process receive each other's heartbeats as echoes. */
    if (HEARTBEAT_BASE < can_id && can_id <= HEARTBEAT_BASE + SKIN_HIGHEST_NODE_ID) {
        skin_heard(node, (uint8_t)(can_id - HEARTBEAT_BASE), now_ms);
    } else if (is_echo) {
        return;
    } else if (can_id == SKIN_SYNC_COB_ID) {
        if (read->counts != NULL) {
            sample(node, read);
        }
        skin_sync(node, frame);
    } else if (can_id == 0) {
        skin_nmt(node, frame, now_ms);
    } else if (can_id == REQUEST_BASE + node->board->node_id && frame->length == 8) {
        skin_request(node, frame, now_ms);
    }
}

size_t skin_power_up(skin_node *nodes, uint32_t first, uint32_t boards, uint32_t now_ms, skin_frame *out, size_t capacity)
{
    skin_outbox outbox = new_outbox(out, capacity);
    uint32_t each;

    for (each = 0; each < boards; each++) {
        skin_init(&nodes[each], &skin_boards[first + each], &outbox);
        skin_boot(&nodes[each], now_ms, 0);
    }
    return outbox.count;
}

size_t skin_take(skin_node *nodes, uint32_t boards, uint32_t now_ms, const uint16_t *counts, uint16_t samples,
                 uint32_t taxels, const skin_frame *frames, size_t count, skin_frame *out, size_t capacity)
{
    const reading read = {counts, samples, taxels};
    skin_outbox outbox = new_outbox(out, capacity);
    uint32_t each;
    size_t place;

    for (place = 0; place < count; place++) {
        for (each = 0; each < boards; each++) {
            nodes[each].outbox = &outbox;
            pass(&nodes[each], &frames[place], now_ms, &read);
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

size_t skin_newest_sums(const skin_node *node, int32_t *sums)
{
    const uint16_t count = node->board->first_sum[node->board->blocks];

    memcpy(sums, node->sums, count * sizeof sums[0]);
    return count;
}

size_t skin_node_bytes(void)
{
    return sizeof(skin_node);
}
