/* Random frames for the boards of board.c, under sanitizers: no frame may break a board's memory or its messages. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "skin_boards.h"

#define ROOM 4096
#define BURST 8

static skin_node nodes[SKIN_BOARDS];
static skin_frame in[BURST], out[ROOM];
static uint32_t state;

/* Memory for programs, one byte too small for the longest download. */
#define SLOT_BYTES 256
static uint8_t slots[SKIN_BOARDS][2][SLOT_BYTES];
static skin_flash flashes[SKIN_BOARDS];

static int erase(void *context, uint8_t slot)
{
    memset((uint8_t *)context + slot * SLOT_BYTES, 0xFF, SLOT_BYTES);
    return 0;
}

static int write_part(void *context, uint8_t slot, uint32_t at, const uint8_t *data, uint16_t bytes)
{
    if (slot > 1 || at + bytes > SLOT_BYTES) {
        abort();
    }
    memcpy((uint8_t *)context + slot * SLOT_BYTES + at, data, bytes);
    return 0;
}

static int read_part(void *context, uint8_t slot, uint32_t at, uint8_t *data, uint16_t bytes)
{
    if (slot > 1 || at + bytes > SLOT_BYTES) {
        abort();
    }
    memcpy(data, (const uint8_t *)context + slot * SLOT_BYTES + at, bytes);
    return 0;
}

static uint32_t drawn(uint32_t below)
{
    state ^= state << 13;
    state ^= state >> 17;
    state ^= state << 5;
    return state % below;
}

static void draw_frame(skin_frame *frame)
{
    const skin_board *board = &skin_boards[drawn(SKIN_BOARDS)];
    const skin_object *object = &board->type->objects[drawn(board->type->object_count)];
    uint32_t place;

    memset(frame, 0, sizeof *frame);
    for (place = 0; place < 64; place++) {
        frame->data[place] = (uint8_t)drawn(256);
    }
    frame->length = (uint8_t)(drawn(20) == 0 ? drawn(65) : 8);
    frame->flags = (uint8_t)(drawn(20) == 0 ? drawn(256) : 0);
    frame->port = (uint16_t)drawn(200);
    frame->time_ns = (int64_t)drawn(1000000) * 1000;
    switch (drawn(10)) {
    case 0: /* SYNC */
        frame->can_id = 0x80;
        frame->length = (uint8_t)drawn(3);
        break;
    case 1: /* NMT */
        frame->can_id = 0;
        frame->length = 2;
        frame->data[0] = (uint8_t[]){1, 1, 1, 1, 2, 128, 129, 130, 77}[drawn(9)];
        frame->data[1] = (uint8_t)drawn(4);
        break;
    case 2: /* heartbeat */
        frame->can_id = 0x700 + drawn(0x80);
        break;
    case 3: /* LSS */
        frame->can_id = 0x7E5;
        frame->data[0] = (uint8_t)(0x04 + drawn(0x5B));
        break;
    case 4: /* anything, and frames that were given up */
        frame->can_id = drawn(2) ? drawn(0x800) : state;
        frame->flags |= drawn(2) ? SKIN_FRAME_DISCARDED : 0;
        break;
    default: /* SDO, mostly of an object that there is */
        frame->can_id = 0x600u + board->node_id;
        if (drawn(4) > 0) {
            frame->data[0] = (uint8_t[]){0x40, 0x23, 0x2B, 0x2F, 0x21, 0x60, 0x70, 0x00, 0x11, 0x0D, 0xA0, 0xC6}[drawn(12)];
        }
        if (drawn(8) > 0) {
            const int is_program = drawn(6) == 0;

            skin_put(&frame->data[1], is_program ? SKIN_OD_PROGRAM_DATA : object->index, 2);
            frame->data[3] = is_program ? 1 : object->subindex;
        }
        if (drawn(2) > 0) { /* small values are taken more often */
            skin_put(&frame->data[4], drawn(300), 4);
        }
        break;
    }
}

/* Let a frame of a download be the next segment, with a header of this board: the other bytes are random. */
static void go_on(skin_frame *frame)
{
    const skin_node *node = &nodes[drawn(SKIN_BOARDS)];
    uint8_t head[SKIN_PROGRAM_HEAD] = {0}, place;

    skin_put(&head[SKIN_PROGRAM_AT_MAGIC], SKIN_PROGRAM_MAGIC, 4);
    skin_put(&head[SKIN_PROGRAM_AT_VENDOR], node->program.vendor_id, 4);
    skin_put(&head[SKIN_PROGRAM_AT_PRODUCT], node->program.product_code, 4);
    skin_put(&head[SKIN_PROGRAM_AT_SIZE], drawn(SLOT_BYTES), 4);
    frame->can_id = 0x600u + node->board->node_id;
    frame->length = 8;
    frame->data[0] = drawn(2) ? (uint8_t)(node->sdo.number + 1) : (uint8_t)(drawn(2) ? node->sdo.toggle : 0xC1);
    for (place = 0; place < 7; place++) {
        const uint32_t at = node->program.bytes + (frame->data[0] != node->sdo.toggle ? node->sdo.done : 0) + place;

        frame->data[1 + place] = at < SKIN_PROGRAM_HEAD ? head[at] : frame->data[1 + place];
    }
}

#if SKIN_STEPPED

/* A sample, and random fates of the frames that come of it. */
static size_t sample(uint16_t *counts, int64_t now_ns)
{
    uint16_t read[SKIN_BOARDS * SKIN_BLOCK_SUMS];
    const size_t from = drawn(65000);
    size_t sent, kept = 0, place;

    for (place = 0; place < SKIN_BOARDS * SKIN_BLOCK_SUMS; place++) {
        read[place] = (uint16_t)(drawn(3) ? counts[from + place] % 1024u : 0);
    }
    skin_take_counts(nodes, SKIN_BOARDS, read);
    sent = skin_choose(nodes, SKIN_BOARDS, now_ns, out, ROOM);
    for (place = 0; place < sent && kept < BURST; place++) {
        in[kept] = out[place];
        in[kept].flags |= (uint8_t)(drawn(5) ? SKIN_FRAME_ECHO : SKIN_FRAME_DISCARDED);
        kept += drawn(4) > 0;
    }
    if (drawn(30) == 0) {
        skin_refuse(nodes, SKIN_BOARDS, out, sent);
    }
    skin_take(nodes, SKIN_BOARDS, 0, NULL, 1, 65536, in, kept, out, ROOM);
    return sent;
}

#endif

static void check(size_t count)
{
    size_t place;

    if (count > ROOM) {
        abort();
    }
    for (place = 0; place < count; place++) {
        if (out[place].length > 64 || out[place].can_id > 0x7FF || out[place].port > 127) {
            abort();
        }
    }
}

int main(int count, char **texts)
{
    static skin_reading counts[65536 * SKIN_MOST_SAMPLES];
    const uint32_t turns = count > 2 ? (uint32_t)strtoul(texts[2], NULL, 10) : 1000;
    uint32_t turn, place, now_ms = 0xFFFF0000u; /* the clock wraps */
    size_t sent = 0, found;

    state = count > 1 ? (uint32_t)strtoul(texts[1], NULL, 10) : 1;
    for (place = 0; place < 65536 * SKIN_MOST_SAMPLES; place++) {
        counts[place] = (skin_reading)drawn(65536);
    }
#if SKIN_STEPPED
    skin_prepare(nodes, 0, SKIN_BOARDS, NULL);
    for (turn = 0; turn < SKIN_IDLE_SAMPLES + SKIN_SETTLING_SAMPLES; turn++) {
        uint16_t read[SKIN_BOARDS * SKIN_BLOCK_SUMS];

        for (place = 0; place < SKIN_BOARDS * SKIN_BLOCK_SUMS; place++) {
            read[place] = (uint16_t)drawn(80);
        }
        skin_take_counts(nodes, SKIN_BOARDS, read);
    }
#endif
    for (place = 0; place < SKIN_BOARDS; place++) {
        flashes[place] = (skin_flash){erase, write_part, read_part, SLOT_BYTES, slots[place]};
    }
    check(skin_power_up(nodes, 0, SKIN_BOARDS, NULL, flashes, 0, now_ms, out, ROOM));
    for (turn = 0; turn < turns; turn++) {
        const uint32_t burst = drawn(BURST) + 1;

        for (place = 0; place < burst; place++) {
            draw_frame(&in[place]);
            if (drawn(3) == 0) {
                go_on(&in[place]);
            }
        }
        found = skin_take(nodes, SKIN_BOARDS, now_ms, drawn(2) ? counts : NULL,
                          (uint16_t)(1 + drawn(SKIN_MOST_SAMPLES)), 65536, in, burst, out, drawn(9) ? ROOM : 3);
        check(found);
        sent += found;
#if SKIN_STEPPED
        found = sample(counts, (int64_t)now_ms * 1000000);
        check(found);
        sent += found;
#endif
        now_ms += drawn(40);
        check(skin_pass_time(nodes, SKIN_BOARDS, now_ms, out, ROOM));
    }
    printf("%lu frames sent\n", (unsigned long)sent);
    return sent > turns / 4 ? 0 : 1;
}
