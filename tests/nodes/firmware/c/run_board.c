/* One board of an image behind the slave: arguments are the number of the bus and the node-ID. Reads a test pattern and then
 * count, bits of the gain and offset of each place; prints the frames that answer four SYNCs, a line for each reading.
 */
#include <stdio.h>
#include <stdlib.h>

#include "skin_node.h"

#define PLACES (SKIN_BLOCKS * SKIN_BLOCK_SIZE)

static skin_node node;
static skin_frame sent[256];
static skin_outbox outbox = {sent, 256, 0};

static void set(uint16_t index, unsigned place, uint32_t value, uint8_t bytes)
{
    const uint16_t above = (uint16_t)(SKIN_BLOCK_STRIDE * (place / SKIN_BLOCK_SIZE));
    uint8_t data[4], subindex = bytes == 1 ? 0 : (uint8_t)(place % SKIN_BLOCK_SIZE + 1);

    skin_put(data, value, bytes);
    if (skin_write(&node, (uint16_t)(index + above), subindex, data, bytes) != 0) {
        printf("%04X:%u is refused ", (unsigned)index + above, subindex);
    }
}

static void answer(const uint16_t *counts)
{
    skin_frame sync = {0};
    unsigned each, byte;

    for (each = 1; each <= 4; each++) {
        uint16_t read[PLACES];

        for (byte = 0; byte < PLACES; byte++) {
            read[byte] = counts[byte];
        }
        sync.length = skin_unsigned(&node, SKIN_OD_SYNC_OVERFLOW, 0) > 0;
        sync.data[0] = (uint8_t)each;
        skin_sample(&node, read, 1);
        skin_sync(&node, &sync);
    }
    for (each = 0; each < outbox.count; each++) {
        printf("%u:", (unsigned)sent[each].can_id);
        for (byte = 0; byte < sent[each].length; byte++) {
            printf("%02x", sent[each].data[byte]);
        }
        printf(" ");
    }
    printf("\n");
    outbox.count = 0;
}

int main(int count, char **texts)
{
    const skin_board *board = count == 3 ? skin_board_of((uint8_t)atoi(texts[1]), (uint8_t)atoi(texts[2])) : NULL;
    const skin_frame start = {.length = 2, .data = {SKIN_NMT_START, 0}};
    uint16_t counts[PLACES];
    unsigned pattern, x, gain, place;
    int offset;

    if (board == NULL) {
        return 1;
    }
    skin_init(&node, board, &outbox, NULL);
    skin_boot(&node, 0, 0);
    printf("%u\n", (unsigned)skin_unsigned(&node, SKIN_OD_SIGNATURE, 0));
    skin_nmt(&node, &start, 0);
    outbox.count = 0;
    while (scanf("%u", &pattern) == 1) {
        for (place = 0; place < PLACES; place++) {
            if (scanf("%u %u %d", &x, &gain, &offset) != 3) {
                return 1;
            }
            counts[place] = (uint16_t)x;
            set(SKIN_OD_GAIN, place, gain, 4);
            set(SKIN_OD_OFFSET, place, (uint32_t)offset, 2);
        }
        for (place = 0; place < PLACES; place += SKIN_BLOCK_SIZE) {
            set(SKIN_OD_TEST_PATTERN, place, pattern, 1);
        }
        answer(counts);
    }
    return 0;
}
